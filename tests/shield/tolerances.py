"""Every tolerance of these tests; bounds have none."""

# Relative distance to the best objective, and what is added for objectives near zero.
OBJECTIVE, OBJECTIVE_FLOOR = 1e-6, 1e-9
# Two exact algorithms in float64.
ROUNDING = 1e-9
# Where the lateral bound binds, relative distance to the best objective of IPOPT.
LATERAL_OBJECTIVE = 5e-3
# CasADi against numpy, relative.
MODEL = 1e-12
# Finite differences, relative.
GRADIENT = 1e-5
