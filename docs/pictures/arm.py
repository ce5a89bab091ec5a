"""Film two of the paper's laws as arm.gif, and write its dark form, with the same hues."""

import colorsys
from pathlib import Path

import imageio_ffmpeg
import numpy as np

from benchmarks.policies.spec import resolve
from benchmarks.report.film import frames
from fbl_gym import scenarios

FOLDER, SIZE, FPS = Path(__file__).parent, 320, 25
PALETTE = "split[a][b];[a]palettegen[colours];[b][colours]paletteuse=dither=none"
FORMAT = {"codec": "gif", "pix_fmt_out": "pal8", "output_params": ["-vf", PALETTE]}


def inverted(red, green, blue):
    """Return a colour of the palette with the opposite lightness, from that of a dark page on."""
    hue, light, vivid = colorsys.rgb_to_hls(red / 255, green / 255, blue / 255)
    spread = max(red, green, blue) - min(red, green, blue)
    dark = 1 - 0.93 * light
    dark += min(spread / 128, 1) * max(0.6 - dark, 0)  # colours stay bright
    return (round(255 * part) for part in colorsys.hls_to_rgb(hue, dark, vivid if spread > 8 else 0.0))


scenario = scenarios.get("everything-3").replace(duration=6.0)
films = zip(*(frames(resolve(policy), scenario, 0, FPS, SIZE) for policy in ("pid-flm", "cascade-flm")), strict=True)
path, size = FOLDER / "arm.gif", (2 * SIZE, SIZE)
writer = imageio_ffmpeg.write_frames(str(path), size, fps=FPS, quality=None, macro_block_size=2, **FORMAT)
writer.send(None)
for pair in films:
    writer.send(np.hstack(pair))
writer.close()

film = bytearray((FOLDER / "arm.gif").read_bytes())
assert film[10] & 0x80, "all frames share one palette"
colours = 2 ** ((film[10] & 7) + 1)  # they begin at byte 13, three bytes each
for start in range(13, 13 + 3 * colours, 3):
    film[start : start + 3] = bytes(inverted(*film[start : start + 3]))
(FOLDER / "arm-dark.gif").write_bytes(film)
