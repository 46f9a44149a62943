"""Measurements of the shield: `python -m shield.bench [projection|estimation|predictive|all]`."""
