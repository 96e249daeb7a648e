"""The noun task: all that the result of one sequence depends on."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from persem_ros.evaluate.work.stream import Disturbance
from persem_ros.inputs.recording.excerpt import Excerpt, WHOLE
from persem_ros.settings.config import Config, IMAGE_METHODS, METHODS

ALL_METHODS = IMAGE_METHODS + METHODS


@dataclass(frozen=True)
class Task:
    """
    All that the result of one sequence depends on.

    Attributes
    ----------
    recording : str
        Path; 'A+B' is one input in two recordings.
    config : Config
    methods : tuple of str
        Some of ALL_METHODS.
    labels : str
        Taxonomy: a shipped legend or a file; '': none.
    grouped, dynamic : bool
        As of taxonomy.taxonomy.
    predictions : str
        Folder of label images that replace the recorded ones; '': none.
    disturbance : Disturbance
    pictures : bool
        Keep what the figures show.
    excerpt : Excerpt
        Which of the frames are used.

    """

    recording: str
    config: Config = field(default_factory=Config)
    methods: tuple[str, ...] = ALL_METHODS
    labels: str = ''
    grouped: bool = False
    dynamic: bool = True
    predictions: str = ''
    disturbance: Disturbance = Disturbance()
    pictures: bool = True
    excerpt: Excerpt = WHOLE

    @property
    def name(self) -> str:
        """Return a short name for people."""
        return Path(self.recording).name
