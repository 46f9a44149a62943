from pathlib import Path

import imageio.v3 as imageio
import pytest

from irl_dal.figures.evaluation import draw_training

COMPLETE = """step,rollout/episode_return,rollout/intervention_rate,bc/loss,bc/train_loss
100,12.5,0.0,0.2,0.3
200,20.0,0.3,,0.1
300,25.0,0.2,0.05,nan
"""

SPARSE = "step,rollout/shield_rate\n100,0.5\n"


@pytest.mark.parametrize("content", [COMPLETE, SPARSE])
def test_every_panel_is_drawn(tmp_path: Path, content: str) -> None:
    """A picture per quantity and one of all, even where a run has logged next to nothing."""
    metrics = tmp_path / "metrics.csv"
    metrics.write_text(content)
    written = draw_training(metrics, tmp_path / "figures", 200)
    assert [path.stem for path in written] == ["reward", "bc_loss", "interventions", "training"]
    for path in written:
        image = imageio.imread(path)
        assert image.shape[0] > 300 and image.std() > 1.0
