"""Traces as a film: the arms of several policies side by side, in real time.

Gymnasium's `RecordVideo` films one environment while a policy acts in it, by moviepy. A trace is
already measured, an external policy's in another process, and no policy acts twice here.
"""

import itertools
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import imageio_ffmpeg
import numpy as np

from benchmarks.files import replacing
from benchmarks.run.metrics import errors
from benchmarks.run.rollout import Trace
from fbl_gym.view.picture import FINER, INK, LETTERS, MARGIN, Frame, Picture, blank, draw, frame_of, write
from fbl_gym.view.render import pair

FPS = {".mp4": 50, ".gif": 25}
"""Frames per second; a GIF's frames last whole hundredths of a second."""

_PALETTE = "split[a][b];[a]palettegen[colours];[b][colours]paletteuse=dither=none"
_WRITER: dict[str, dict[str, Any]] = {
    ".mp4": {"codec": "libx264", "pix_fmt_out": "yuv420p", "output_params": ["-crf", "18"]},
    ".gif": {"codec": "gif", "pix_fmt_out": "pal8", "output_params": ["-vf", _PALETTE]},
}


def write_video(traces: Mapping[str, Trace], path: Path, size: int = 480) -> None:
    """Film the first seed of some traces of one scenario, at a constant rate and in real time.

    Each arm has a square of `size` pixels, an even number.

    Raises:
        ValueError: the path does not end in .mp4 or .gif.
    """
    ending = path.suffix.lower()
    if ending not in FPS:
        raise ValueError(f"path must end in {' or '.join(FPS)}, got {str(path)!r}")
    frames = film(traces, FPS[ending], size)
    first = next(frames)
    height, width, _ = first.shape
    with replacing(path) as beside:
        writer = imageio_ffmpeg.write_frames(
            str(beside), (width, height), fps=FPS[ending], quality=None, macro_block_size=2, ffmpeg_log_level="error",
            **_WRITER[ending],
        )  # fmt: skip
        writer.send(None)
        for frame in itertools.chain([first], frames):
            writer.send(frame)
        writer.close()


def film(traces: Mapping[str, Trace], fps: float, size: int = 480) -> Iterator[Frame]:
    """Yield the frames of `write_video`, one for each 1 / fps seconds of the episode."""
    first = next(iter(traces.values()))
    header, fine = blank(len(traces) * size, 2 * round(0.04 * size)), FINER * size
    write(header, f"{first.scenario.name}, seed {first.seeds[0]}", (MARGIN * fine, 0.048 * fine), LETTERS * fine, INK)
    strip = frame_of(header)
    for k in range(int(first.time[-1] * fps + 1e-9) + 1):
        sample = min(round(k / fps / first.scenario.control_dt), len(first.time) - 1)
        yield np.vstack(
            [strip, np.hstack([draw(picture(name, trace, sample), size) for name, trace in traces.items()])]
        )


def picture(title: str, trace: Trace, k: int) -> Picture:
    """Return sample k of a trace's first seed; an arm that diverged stays at its last position."""
    last = int(trace.alive[:, 0].sum()) - 1
    sample, rms = min(k, last), np.sqrt((errors(trace)[: k + 1, 0] ** 2).mean())
    return Picture(
        title=title,
        subtitle=f"RMS error {1e3 * rms:,.1f} mrad" if k <= last else f"diverged at {trace.time[last + 1]:.2f} s",
        time=float(trace.time[k]),
        lengths=pair(trace.lengths[0]),
        position=pair(trace.position[sample, 0]),
        reference=pair(trace.reference[k, 0]),
        torque=pair(trace.torque[sample, 0]),
        disturbance=None if trace.scenario.disturbance is None else pair(-trace.disturbance[sample, 0]),
        payload=float(trace.payload[sample, 0]),
    )
