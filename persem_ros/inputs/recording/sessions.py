"""Several inputs as sessions of one map, in the order in which they were given."""

from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from typing import Any

from persem_ros.frames import Frame
from persem_ros.inputs.recording.recording import Recording
from persem_ros.inputs.recording.source import TopicInfo


class Sessions:
    """
    Recordings one after the other; each is a session.

    Classes are told by their names: those of later recordings get the ids of the first.

    Parameters
    ----------
    recordings : sequence of Recording
        Open, one at least; they are closed with this.

    """

    def __init__(self, recordings: Sequence[Recording]) -> None:
        self.recordings = list(recordings)
        self._stack = ExitStack()
        for recording in self.recordings:
            self._stack.enter_context(recording)
        legend = self.recordings[0].legend
        for recording in self.recordings[1:]:
            if legend.classes and not recording.config.labels.legend:
                recording.go_on(legend)
            legend = recording.legend

    def __enter__(self) -> 'Sessions':
        """Return this."""
        return self

    def __exit__(self, *error: Any) -> None:
        """Close all recordings."""
        self._stack.close()

    def frames(self, truth: bool = False, color: bool = False) -> Iterator[tuple[int, Frame]]:
        """Yield (number of the session, frame); parameters and refusals as of Recording."""
        for number, recording in enumerate(self.recordings):
            for frame in recording.frames(truth=truth, color=color):
                yield number, frame

    @property
    def name(self) -> str:
        """Return a short name for people."""
        return ', '.join(recording.name for recording in self.recordings)

    @property
    def words(self) -> list[str]:
        """Return the inputs and the options of their excerpt, as words of a command line."""
        return [*(str(recording.path) for recording in self.recordings),
                *self.recordings[0].excerpt.words()]

    @property
    def expected(self) -> int:
        """Return the number of label images, for progress; frames may be fewer."""
        return sum(recording.expected for recording in self.recordings)

    @property
    def dropped(self) -> Counter[str]:
        """Return what was not used in the last reading of each, by reason."""
        return sum((recording.dropped for recording in self.recordings), start=Counter())

    @property
    def examples(self) -> dict[str, str]:
        """Return one whole sentence for reasons that have one."""
        return {reason: text for recording in reversed(self.recordings)
                for reason, text in recording.examples.items()}

    @property
    def notes(self) -> list[str]:
        """Return what the user should know: sentences."""
        return [self._named(recording, note)
                for recording in self.recordings for note in recording.notes]

    @property
    def unsaid(self) -> list[str]:
        """Return the notes that the user has not read before the mapping."""
        return [self._named(recording, note) for recording in self.recordings
                for note in recording.notes if note not in recording.said]

    @property
    def topics(self) -> dict[str, dict[str, TopicInfo]]:
        """Return what is used by camera and kind; of several recordings those of the first."""
        return self.recordings[0].topics

    @property
    def legend_text(self) -> str:
        """Return the legend (YAML) of all recordings, '' without any."""
        return self.recordings[-1].legend_text      # which has learnt those before

    def has(self, kind: str) -> bool:
        """Return whether any recording has the optional topic 'truth' or 'color'."""
        return any(recording.has(kind) for recording in self.recordings)

    def _named(self, recording: Recording, note: str) -> str:
        """Return a note with the name of its recording, where there are several."""
        named = len(self.recordings) == 1 or recording.name in note
        return note if named else f'{recording.name}: {note}'
