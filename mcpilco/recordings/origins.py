"""How recordings may have come about: by which clock commands went out, and in what timesteps."""

from __future__ import annotations

from collections.abc import Sequence

from mcpilco.plant import ChainPlant, Plant
from mcpilco.recordings.recording import Recording

STEPS = (1.0, 0.5, 0.25)
"""parts of a file's timestep in which its simulator may have made recordings [-]"""


def possible_origins(
    plant: Plant, recordings: Sequence[Recording]
) -> list[tuple[Plant, tuple[Recording, ...]]]:
    """A plant and recordings of it in the ways in which they may go together, the usual one first.

    Where a log leaves doubt, a clock sent the commands out, or they went out as they are stamped.
    Where the plant was read from a file of a simulator, that may have made the recordings, in the
    file's timestep or a part of it, see `mcpilco.plant.FirstOrder`.
    """
    recordings = [recording.earlier(0.0) for recording in recordings]
    origins = [(plant, tuple(recording.clocked for recording in recordings))]
    if any(recording.by_clock is not None for recording in recordings):
        origins.append((plant, tuple(recordings)))
    if isinstance(plant, ChainPlant) and plant.integrator is not None:
        for part in STEPS:
            late_s = 0.5 * part * plant.integrator.timestep_s
            moved = tuple(recording.earlier(late_s) for recording in recordings)
            origins.append((plant.in_steps(part), moved))
    return origins
