"""Clips and pictures of recordings, without a display."""

from __future__ import annotations

from collections.abc import Generator, Iterator, Mapping
from contextlib import closing, suppress
from dataclasses import replace
from functools import lru_cache
from importlib.util import find_spec
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from wbmpc.errors import InputError, WbmpcError
from wbmpc.output_file import whole_file
from wbmpc.simulation.film import SceneModel
from wbmpc.simulation.render import BASE, END_EFFECTOR, REFERENCE, TRAIL, Camera, Renderer
from wbmpc.simulation.scene import Scene
from wbmpc.view.camera import hidden, near
from wbmpc.view.replay import Film, check_length

Array = np.ndarray
Color = tuple[int, int, int]
#: What lines are, by their names in a snapshot.
NAMES = {
    "reference": "reference", "trail": "way", "end_effector_plan": "predicted end effector", "base_plan": "predicted base",
}  # fmt: skip
#: Height of letters over the height of a picture; the lowest that can be read [pixels].
_LETTERS, _LOWEST = 1.0 / 24.0, 10
_INK = (35, 45, 55)
#: How much of the picture a label's ground hides.
_GROUND = 0.6


class Labels:
    """Of pictures of ``size`` (width, height) of the run ``title``."""

    def __init__(self, size: tuple[int, int], title: str) -> None:
        self._height, self._title = max(_LOWEST, round(size[1] * _LETTERS)), title

    def on(self, picture: Array, t: float, lines: Mapping[str, Color]) -> Array:
        """The picture (height, width, 3) with them, at the time t [s]; ``lines``: colors by their names in a snapshot."""
        left = edge = self._height // 2
        for name, color in lines.items():
            left += _put(picture, strip(NAMES[name], self._height, color), left, edge) + edge
        # the title stays, so that only the time is written anew
        left = edge
        for text in (self._title, f"{t:.1f} s"):
            below = strip(text, self._height, _INK)
            left += _put(picture, below, left, picture.shape[0] - below[1].shape[0] - edge)
        return picture


@lru_cache(maxsize=32)
def strip(text: str, height: int, color: Color) -> tuple[Array, Array]:
    """A text with letters of a height [pixels] on a white ground: its colors (rows, columns, 3) times its share of each pixel, and the
    share that is left of the picture there (rows, columns, 3), both times 256 in 16 bits."""
    from PIL import Image, ImageDraw

    font = _font(height)
    right = int(font.getbbox(text)[2])
    sheet = Image.new("L", (right + height, height * 3 // 2), 0)
    ImageDraw.Draw(sheet).text((height // 2, height // 8), text, fill=255, font=font)
    ink = np.asarray(sheet, float)[..., None] / 255.0
    share = np.maximum(ink, _GROUND)
    left_over = np.repeat(np.round(256.0 * (1.0 - share)), 3, axis=2)
    colors = (256.0 - left_over) * (ink * np.array(color) + (1.0 - ink) * 255.0)
    return np.round(colors).astype(np.uint16), left_over.astype(np.uint16)


@lru_cache(maxsize=4)
def _font(height: int) -> Any:
    from PIL import ImageFont

    return ImageFont.load_default(height)


def _put(picture: Array, label: tuple[Array, Array], left: int, top: int) -> int:
    """Write a label into a picture, as far as there is room; its width [pixels]."""
    colors, left_over = label
    part = picture[max(top, 0) :, left:][: colors.shape[0], : colors.shape[1]]
    rows, columns = part.shape[:2]
    part[:] = (colors[:rows, :columns] + left_over[:rows, :columns] * part) >> 8
    return int(colors.shape[1])


#: Lines of a snapshot, the last in front.
LINES = {"reference": REFERENCE, "trail": TRAIL, "base_plan": BASE, "end_effector_plan": END_EFFECTOR}
#: Pictures per second of clips: of a film, of pictures that move in a page. Both divide the rate of recorded frames (50 Hz): else some
#: pictures would be of the next frame, others of the one after it, and what moves evenly would stutter.
RATES = {".mp4": 25.0, ".gif": 12.5, ".webp": 12.5}
#: A film has too many pictures for smooth edges, which take half of the time: its speed hides them.
_ROUGH = (".mp4",)
GIF_COLORS = 64
#: Bytes of a picture's pixel in clips that are put together in memory, and of all pictures of one at most.
HELD, LARGEST = {".gif": 1, ".webp": 3}, 2e9
#: What a GIF can hold of the time [ms] that a picture stands.
LONGEST_PAUSE = 600_000
#: Speeds of a clip against the run.
SPEEDS = (0.01, 1000.0)
#: Of 100: edges stay clear, and a clip is smaller than a GIF.
WEBP_QUALITY = 40
#: A camera's elevations [rad], the best first; at how many moments of a clip it is looked whether something hides the robot.
_ELEVATIONS, _LOOKS = (-0.38, -0.7, -1.0), 12
NO_GRAPHICS = (
    "render: neither EGL nor OSMesa starts: install one of them (on Debian and Ubuntu: apt-get install libegl1 libgl1-mesa-dri, "
    "or libosmesa6)"
)


def render(
    film: Film, path: Path, times: tuple[float, float], size: tuple[int, int], speed: float = 1.0, labels: bool = True
) -> int:
    """Draw from ``times[0]`` to ``times[1]`` [s] into a file by its ending: .mp4, .gif, .webp, or .png (the first moment alone).

    ``size``: width, height; ``speed``: of the clip against the run; ``labels``: whether title, time and the meaning of lines stand on it. Returns
    the number of pictures.
    """
    kind = path.suffix.lower()
    if kind not in (*RATES, ".png"):
        raise InputError(f"render: '{path}': valid endings: .mp4, .gif, .webp, .png")
    if find_spec("imageio") is None or (kind == ".mp4" and find_spec("imageio_ffmpeg") is None):
        raise InputError("render: this needs imageio: pip install 'wbmpc[video]'")
    if kind == ".mp4" and (size[0] % 2 or size[1] % 2):
        raise InputError(
            f"render: a film's width and height must be even (its codec halves them), got {size[0]} and {size[1]}"
        )
    start, end = max(times[0], float(film.times[0])), min(times[1], float(film.times[-1]))
    if not SPEEDS[0] <= speed <= SPEEDS[1]:
        raise InputError(f"render: the speed must be {SPEEDS[0]:g} to {SPEEDS[1]:g}, got {speed:g}")
    if not start <= end or (kind == ".png" and 0.0 < times[0] < start):
        raise InputError(
            f"render: from {times[0]:g} to {times[1]:g} s there is nothing to draw: the recording has {film.times[0]:g} to {film.times[-1]:g} s"
        )
    if kind != ".png":
        check_length(film, (end - start) / speed, "a clip")
    moments = (
        np.array([start])
        if kind == ".png"
        else start + np.arange(int((end - start) * RATES[kind] / speed + 1e-6) + 1) * speed / RATES[kind]
    )
    pauses: list[int] = []
    if kind in HELD:
        moments, pauses = _without_repetitions(film, moments, kind, speed)
        _check_memory(path, len(moments) * size[0] * size[1] * HELD[kind])
    pictures = _pictures(film, moments, size, labels, kind)
    first = next(pictures)  # whether there are graphics at all shows before a file is begun
    existed = path.exists()
    path.open("ab").close()  # and whether it can be written, before all is drawn
    if not existed:
        path.unlink()
    with whole_file(path) as partial, closing(pictures):
        _WRITERS[kind](partial, chain([first], pictures), pauses)
    return len(moments)


def _without_repetitions(film: Film, moments: np.ndarray, kind: str, speed: float) -> tuple[np.ndarray, list[int]]:
    """Moments [s] of a clip whose pictures differ, and for how long [ms] each is shown: where nothing was recorded, one stands still."""
    shown = np.searchsorted(film.times, moments, side="right")
    kept = moments[np.flatnonzero(np.diff(shown, prepend=-1))]
    lengths = np.diff(kept, append=moments[-1] + speed / RATES[kind]) / speed
    return kept, [min(round(1e3 * length), LONGEST_PAUSE) for length in lengths]


def _check_memory(path: Path, needed: int) -> None:
    """Raise :class:`InputError` for a clip of too many pictures: its writer has all of them at once."""
    if needed > LARGEST:
        raise InputError(
            f"render: the pictures of '{path}' need {needed / 1e9:.1f} GB, at most {LARGEST / 1e9:.0f} are taken; valid: --mp4, a smaller "
            "picture, a part of the run (--start, --end), a faster clip (--speed)"
        )


def _pictures(
    film: Film, moments: np.ndarray, size: tuple[int, int], labels: bool = True, kind: str = ".png"
) -> Generator[np.ndarray]:
    scene_model = SceneModel(film.scene)
    scene_model.place(film.picture(float(moments[0]))["poses"])
    try:
        renderer = Renderer(
            scene_model, *size, shadows="floor" if kind in RATES else "all", samples=0 if kind in _ROUGH else 4
        )
    except WbmpcError as error:
        raise InputError(f"{NO_GRAPHICS} ({error})") from error
    camera = overview([film.picture(t)["poses"] for t in np.linspace(moments[0], moments[-1], _LOOKS)], film.scene)
    drawn = Labels(size, film.recording.title) if labels else None
    with renderer:
        previous = -1
        for t, shown in zip(moments, np.searchsorted(film.times, moments, side="right"), strict=True):
            if shown != previous:  # a film goes on at its rate where nothing was recorded
                s, previous = film.picture(float(t)), shown
                scene_model.place(s["poses"])
                lines = {n: (color, s[n]) for n, color in LINES.items() if np.isfinite(s[n]).all(axis=1).sum() > 1}
                picture = renderer.frame(camera, list(lines.values()))
            colors = {n: color for n, (color, _) in lines.items()}
            yield picture.copy() if drawn is None else drawn.on(picture.copy(), float(t), colors)


def _write_png(path: Path, pictures: Iterator[np.ndarray], pauses: list[int]) -> None:
    from PIL import Image

    Image.fromarray(next(pictures)).save(path)


def _write_mp4(path: Path, pictures: Iterator[np.ndarray], pauses: list[int]) -> None:
    """The next pictures are drawn while the encoder's process has the last ones. The library does not check how it ended: pictures are
    counted in what it left."""
    from imageio_ffmpeg import count_frames_and_secs, write_frames

    first = next(pictures)
    options: dict[str, Any] = {"codec": "libx264", "macro_block_size": 2, "ffmpeg_log_level": "quiet"}
    # as small as by the default, in less than half of the time
    options["output_params"] = ["-preset", "veryfast", "-x264-params", "subme=1"]
    encoder = write_frames(str(path), first.shape[1::-1], fps=RATES[".mp4"], **options)
    next(encoder)
    count = written = 0
    with closing(encoder):
        for picture in chain([first], pictures):  # what drawing raises is no failure of the encoder
            written += 1
            try:
                encoder.send(np.ascontiguousarray(picture))
            except OSError:  # it ended early
                break
    with suppress(OSError, RuntimeError, ValueError):  # it left no film at all
        count = count_frames_and_secs(str(path))[0]
    if count != written:
        raise OSError(f"{count} of {written} pictures are in it; the disk may be full")


def _write_gif(path: Path, pictures: Iterator[np.ndarray], pauses: list[int]) -> None:
    """Few colors and no dither: a third of the size, and surfaces do not flicker."""
    from PIL import Image

    frames = [Image.fromarray(p).quantize(GIF_COLORS, dither=Image.Dither.NONE) for p in pictures]
    frames[0].save(path, save_all=True, append_images=frames[1:], duration=pauses, loop=0, optimize=True)


def _write_webp(path: Path, pictures: Iterator[np.ndarray], pauses: list[int]) -> None:
    from PIL import Image

    frames = [Image.fromarray(p) for p in pictures]
    options: dict[str, Any] = {"quality": WEBP_QUALITY, "method": 2}
    frames[0].save(path, "WEBP", save_all=True, append_images=frames[1:], duration=pauses, loop=0, **options)


_WRITERS = {".png": _write_png, ".gif": _write_gif, ".webp": _write_webp, ".mp4": _write_mp4}


def overview(moments: list[np.ndarray], scene: Scene) -> Camera:
    """A view of the whole robot by the size that it has at the beginning, from where least hides it over the ``moments``: poses
    (n, 7) each. The higher a camera stands, the less it shows of what is upright."""
    around = near(moments[0], scene)
    size = float(np.ptp(around, axis=0).max())
    camera = Camera(target=(0.0, 0.1, 0.4 * float(around[:, 2].max())), distance=1.2 + 2.4 * size)
    turned = (camera.azimuth, np.pi - camera.azimuth, -camera.azimuth, camera.azimuth - np.pi)
    choices = [replace(camera, azimuth=a, elevation=e) for e in _ELEVATIONS for a in turned]
    counts = [hidden(scene, poses, [_eye(c, poses[scene.index]) for c in choices]) for poses in moments]
    return choices[int(np.argmin(np.sum(counts, axis=0)))]


def _eye(camera: Camera, robot: np.ndarray) -> np.ndarray:
    """Where a camera stands (3) [m] that follows a robot at pose (7)."""
    level = np.cos(camera.elevation)
    looks = np.array([level * np.cos(camera.azimuth), level * np.sin(camera.azimuth), np.sin(camera.elevation)])
    place: np.ndarray = robot[:3] * [1.0, 1.0, 0.0] + camera.target - camera.distance * looks
    return place
