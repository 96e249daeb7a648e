"""The report as a watcher of a replay: keeps little while frames pass, writes at the end."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from typing import Any, TYPE_CHECKING

import numpy as np
from persem_ros.outputs.files import write_text
from persem_ros.outputs.report import page
from persem_ros.outputs.report.series import FlickerSeries
from persem_ros.outputs.report.strip import panels, sample, Strip

if TYPE_CHECKING:
    from persem_ros.frames import Frame
    from persem_ros.outputs.report.strip import Sample
    from persem_ros.passes import Replay
    from persem_ros.rendering import Rendering


class ReportWatcher:
    """Writes report.html into the folder of a replay (persem_ros.passes.Replay)."""

    def __init__(self) -> None:
        self._flicker = FlickerSeries()
        self._strip: Strip | None = None

    def frame(self, replay: Replay, frame: Frame, rendering: Rendering) -> None:
        """Keep the frame's flicker, and of some frames what the page shows of them."""
        if self._strip is None:
            self._strip = Strip(replay.recording.expected)
        self._flicker.add(frame.stamp, replay.metrics.flicker_counts())
        offer(self._strip, replay, frame, rendering)

    def finish(self, replay: Replay, result: dict[str, Any]) -> None:
        """Write report.html."""
        method = replay.config.refine.method
        samples = self._strip.chosen() if self._strip else []
        with ThreadPoolExecutor(2) as pool:     # zlib and OpenCV let go of the interpreter
            shown = list(pool.map(lambda s: panels(s, replay.legend, method), samples))
        frames = [{'number': s.number, 'seconds': (s.stamp - samples[0].stamp) / 1e9,
                   'sensor': s.sensor, 'panels': p} for s, p in zip(samples, shown)]
        ids = sorted({int(i) for s in samples for image in s.images.values()
                      for i in np.unique(image)})
        text = page.render(replay, result, frames, ids, self._flicker.lines())
        write_text(replay.folder / 'report.html', text)


def offer(strip: Strip, replay: Replay, frame: Frame, rendering: Rendering) -> None:
    """Count a rendered frame; keep a Sample of it if the strip wants it."""
    def make(number: int) -> Sample:
        memory = replay.pipeline.memory
        sources = np.ascontiguousarray(memory.m.voxels['source'][:memory.n_numbers])
        return sample(number, frame, rendering, replay.config.refine.method,
                      replay.config.render.fill, sources)

    strip.offer(make)
