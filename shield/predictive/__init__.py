"""Passive safety: a command passes only if a certified manoeuvre that ends at rest follows it."""

from shield.predictive.assumptions import Assumptions
from shield.predictive.outlook import Outlook
from shield.predictive.predictive_filter import PredictiveFilter

__all__ = ["Assumptions", "Outlook", "PredictiveFilter"]
