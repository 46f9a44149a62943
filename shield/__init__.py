"""A safety shield for commands (steering, speed) whose bounds hold exactly.

`HorizonProjector` finds the nearest horizon within box, rate and lateral acceleration bounds;
`SafetyFilter` guards one command at a time; `ObstacleBarrier`
bounds it by what is around the car; the trackers and the trigger tell when to worry.
`shield.gym` puts the shield around an environment. The guarantees and their proofs are in the
package's README.
"""

from shield.barrier import BarrierConfig, ObstacleBarrier
from shield.certificate import BatchProjection, Certificate, Projection, Status
from shield.command_bounds import CommandBounds
from shield.errors import InvalidLimits, InvalidProblem, MissingDependency, ShieldError
from shield.estimation import (
    ClearanceEstimate,
    ClearanceTracker,
    LaneEstimate,
    LaneMeasurement,
    LaneTracker,
)
from shield.limits import ActuatorLimits
from shield.projection import HorizonProjector
from shield.safety_filter import SafetyFilter
from shield.tracking import ClusterTracker, Track
from shield.trigger import Risk, RiskTrigger, TriggerConfig
from shield.vehicle import KinematicBicycle

__all__ = [
    "ActuatorLimits",
    "BarrierConfig",
    "BatchProjection",
    "Certificate",
    "ClearanceEstimate",
    "ClearanceTracker",
    "ClusterTracker",
    "CommandBounds",
    "HorizonProjector",
    "InvalidLimits",
    "InvalidProblem",
    "KinematicBicycle",
    "LaneEstimate",
    "LaneMeasurement",
    "LaneTracker",
    "MissingDependency",
    "ObstacleBarrier",
    "Projection",
    "Risk",
    "RiskTrigger",
    "SafetyFilter",
    "ShieldError",
    "Status",
    "Track",
    "TriggerConfig",
]
