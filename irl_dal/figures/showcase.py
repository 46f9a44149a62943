"""What a run leaves behind for people: its numbers, its curves and a film of one drive."""

from contextlib import closing

from rich.console import Console

from irl_dal.cli.threads import one_thread
from irl_dal.evaluation.rig import AgentSpec, Rig
from irl_dal.evaluation.rollout import drive_episode
from irl_dal.evaluation.suite import evaluate
from irl_dal.evaluation.summary import evaluation_table
from irl_dal.figures.evaluation import draw_training
from irl_dal.figures.panels import film_writer
from irl_dal.figures.video import DriveFilm
from irl_dal.storage.atomic import write_json
from irl_dal.storage.run_folder import RunFolder


def show_run(folder: RunFolder, console: Console) -> None:
    """Evaluate a trained run, write and print the numbers, draw its figures and its film."""
    config, spec = folder.config, AgentSpec("run", folder.path)
    evaluation = evaluate(config, spec, folder.path.parent, console)
    write_json(folder.evaluation, evaluation.report)
    console.print(evaluation_table(evaluation.report, f"{config.variant}, {folder.path}"))
    written = [folder.evaluation]
    boundary, video = config.learning.imitation_steps, folder.path / "drive.mp4"
    written += draw_training(folder.metrics, folder.path / "figures", boundary)
    if config.evaluation.video_duration > 0.0:
        # the episode worth showing: a success if there is one, with the most planner steps
        best = max(evaluation.episodes, key=lambda entry: (entry["success"], entry["triggered"]))
        with (
            console.status("filming one drive"),
            one_thread(),
            closing(Rig.build(config, spec, render_mode="rgb_array")) as rig,
            film_writer(video, 1.0 / config.limits.dt) as writer,
        ):
            film = DriveFilm(writer, rig.loop, config.evaluation.video_duration)
            drive_episode(rig.loop, rig.agent, best["seed"], film.watch)
        written.append(video)
    for path in written:
        console.print(f"written to {path}", soft_wrap=True)
