"""Draw one step of a drive: what the shield certified, and why it refused what was asked for.

python -m irl_dal.explain run=DIR | policy=expert|random [drive=N] [step=N] [out=FILE.png]
"""

from irl_dal.cli.preflight import preflight

preflight("drive", "report", command=__name__)

from contextlib import closing
from pathlib import Path

from omegaconf import DictConfig

from irl_dal.cli.command import new_console, run_command
from irl_dal.cli.overrides import path_argument, require_writable
from irl_dal.config import ConfigError
from irl_dal.evaluate import subject
from irl_dal.evaluation.rig import Rig
from irl_dal.figures.certified_step import certified_step
from irl_dal.figures.style import picture
from shield import Certificate, PredictiveFilter


def main() -> None:
    """Entry point of the command."""
    run_command(_main, "explain")


def _main(composed: DictConfig) -> None:
    config, spec = subject(composed)
    out = path_argument(composed, "out") or Path("step.png")
    require_writable("out", out)
    for key, least in (("drive", 0), ("step", 1)):
        value = composed[key]
        if value is not None and (isinstance(value, bool) or not isinstance(value, int)):
            raise ConfigError(f"{key} = {value!r}: must be a whole number")
        if value is not None and value < least:
            raise ConfigError(f"{key} = {value}: must be at least {least}")
    with closing(Rig.build(config, spec)) as rig:
        shield = rig.loop.supervision.safety_filter
        if not isinstance(shield, PredictiveFilter):
            raise ConfigError("shield: nothing is certified with shield.level=off or shield=off")
        step, certificate = _drive(rig, composed.drive, composed.step)
        picture(certified_step(shield, certificate), str(out))
    console = new_console()
    console.print(f"step {step}: {certificate.status}: {certificate.reason or 'certified'}")
    console.print(f"written to {out}", soft_wrap=True)


def _drive(rig: Rig, seed: int, target: int | None) -> tuple[int, Certificate]:
    """Drive up to a step, or to the first that the shield changes; its number and certificate."""
    rig.agent.reset(seed)
    observation, info = rig.loop.reset(seed=seed)
    step, over = 0, False
    while not over:
        action = rig.agent.act(observation, info)
        observation, _, terminated, truncated, info = rig.agent.drive(rig.loop, action)
        step, over = step + 1, terminated or truncated
        certificate: Certificate = info["certificate"]
        if step == target or (target is None and certificate.intervened):
            return step, certificate
    if target is None:
        raise ConfigError(f"drive = {seed}: the shield changed none of the {step} steps")
    raise ConfigError(f"step = {target}: the drive ended after {step} steps")


if __name__ == "__main__":
    main()
