"""A safety shield for commands (steering, speed) whose bounds hold exactly.

`HorizonProjector` finds the nearest horizon within box, rate and lateral acceleration bounds;
`SafetyFilter` guards one command at a time; `PredictiveFilter` lets one pass only if a certified
manoeuvre that ends at rest follows it; the trackers and the trigger tell when to worry.
`shield.gym` puts the shield around an environment. The guarantees and their proofs are in the
package's README.
"""

from shield.errors import InvalidLimits, InvalidProblem, MissingDependency, ShieldError
from shield.estimation.clearance import ClearanceEstimate, ClearanceTracker
from shield.estimation.clusters import ClusterTracker, Track
from shield.estimation.lane import LaneEstimate, LaneGeometry, LaneMeasurement, LaneTracker
from shield.estimation.scan import ScannerGeometry
from shield.follower import SetpointFollower
from shield.limits.actuator_limits import ActuatorLimits
from shield.limits.constraint import UNBOUNDED, Constraint, Rows
from shield.predictive import Assumptions, Outlook, PredictiveFilter
from shield.projection.certificate import Certificate, Projection, Status
from shield.projection.projector import HorizonProjector
from shield.safety_filter import SafetyFilter
from shield.trigger import Risk, RiskTrigger, TriggerConfig
from shield.vehicle import KinematicBicycle, VehicleGeometry
from shield.world import Corridor, World

__all__ = [
    "ActuatorLimits",
    "Assumptions",
    "Certificate",
    "ClearanceEstimate",
    "ClearanceTracker",
    "ClusterTracker",
    "Constraint",
    "Corridor",
    "HorizonProjector",
    "InvalidLimits",
    "InvalidProblem",
    "KinematicBicycle",
    "LaneEstimate",
    "LaneGeometry",
    "LaneMeasurement",
    "LaneTracker",
    "MissingDependency",
    "Outlook",
    "PredictiveFilter",
    "Projection",
    "Risk",
    "RiskTrigger",
    "Rows",
    "SafetyFilter",
    "ScannerGeometry",
    "SetpointFollower",
    "ShieldError",
    "Status",
    "Track",
    "TriggerConfig",
    "UNBOUNDED",
    "VehicleGeometry",
    "World",
]
