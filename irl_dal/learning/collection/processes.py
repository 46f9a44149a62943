"""Cars in processes of their own."""

from __future__ import annotations

from stable_baselines3.common.vec_env import SubprocVecEnv

__all__ = ["DriverProcesses"]


class DriverProcesses(SubprocVecEnv):
    """Can be closed at any moment, in the middle of a stretch too.

    Whoever is interrupted has heard from some cars and not from others, and stable-baselines3 would
    wait for those whose answer it has already. Nothing in these processes needs an orderly end.
    """

    def close(self) -> None:
        """End the processes, whatever they do."""
        if self.closed:
            return
        for process in self.processes:
            process.terminate()
        for process in self.processes:
            process.join()
        self.closed = True
