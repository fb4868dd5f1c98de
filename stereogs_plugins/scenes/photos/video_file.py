"""`video`: frames of a video file as photographs without cameras.

Of evenly spaced candidates, the frames are chosen that are sharp (variance of the Laplacian, Pech-Pacheco et
al. 2000) and have the same image motion between them. Candidates that show the same as the one before, as in
24 frames a second stored as 30, count once.

    STEREOGS_CACHE/frames/<key>/frame_000123.png    key: hash of the file, number of frames, this code
"""

from __future__ import annotations

import hashlib
import logging
import shutil
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, ClassVar, NamedTuple

from pydantic import Field

from registry import Fact, Scene, SceneError, SceneLoader
from registry.toolkit import counted
from registry.toolkit.cache import Cache, content_key, source_digest
from registry.toolkit.photos import Impression

from .loader import PhotosScene, PhotosSettings, affordable_side

if TYPE_CHECKING:
    import cv2.typing
    import numpy as np
    from numpy.typing import NDArray

    Pixels = NDArray[np.uint8]

VIDEO_SUFFIXES = (".mp4", ".mov", ".m4v", ".avi", ".mkv", ".webm")
"""Suffixes of video files, in lower case."""
CANDIDATES = 8
"""Frames that are considered for each chosen one."""
_SHARPNESS_SIZE, _MOTION_SIZE = 640, 160
"""Longer side, in pixels, of the frames in which sharpness and motion are measured."""
_MIN_FRAMES = 3
_FEWEST = 6
"""Frames at least when time is short: neighbours among fewer rarely show the same."""
_CPU_SECONDS = 5.0
"""For a frame's cameras: 11 to 16 for 4 photographs of 500 pixels, 37 to 50 for 8, 60 to 68 for 12."""
_MIN_MOTION = 1e-4
"""Motion between candidates at least, as a share of the frame: frames of a still clip are spaced by time."""
_FIX = (
    "check that it plays, or convert it: ffmpeg -i VIDEO clip.mp4; or give a folder of photographs"
)

_log = logging.getLogger("stereogs.photos")


class VideoSettings(PhotosSettings):
    path: Path
    """Path of the video file."""
    frames: int = Field(12, ge=3, le=500)
    """Number of frames to use, at most."""


class VideoScene(SceneLoader[VideoSettings]):
    """Takes sharp, well-spaced frames of a video; `photos` finds their cameras."""

    recognized_by: ClassVar[str] = "the video file itself (.mp4, .mov, ...)"

    @classmethod
    def recognizes(cls, folder: Path) -> bool:
        """Return True for a file with the suffix of a video."""
        return folder.suffix.lower() in VIDEO_SUFFIXES and folder.is_file()

    @classmethod
    def priors_of(cls, settings: VideoSettings) -> dict[str, str]:
        """Return the prior in `cameras`."""
        return settings.priors

    @classmethod
    def within(cls, settings: VideoSettings, cpu_seconds: float) -> VideoSettings:
        """Take fewer frames, at least six, then find cameras in smaller ones, of at least 600 pixels.

        Frames that were chosen before stay: their cameras are known.
        """
        frames = min(settings.frames, max(_FEWEST, int(cpu_seconds / _CPU_SECONDS)))
        video = settings.path.expanduser()
        if not video.is_file() or Cache("frames").load(_key(video, settings.frames), Path.is_dir):
            return settings
        changed = {"frames": frames}
        side = affordable_side(settings.matching_size, frames, cpu_seconds)
        if frames <= _FEWEST and side < min(settings.matching_size, _longer_side(video)):
            changed["matching_size"] = side
        return settings.model_copy(update=changed)

    def load(self) -> Scene:
        """Return the scene.

        Raises:
            SceneError: the file is missing or not a video, or as for `photos`.
        """
        settings = self.settings
        video = settings.path.expanduser()
        with TemporaryDirectory(prefix="stereogs-") as place:
            folder = Path(place, video.stem)
            folder.mkdir()
            _extract(video, settings.frames, folder)
            photos = settings.model_dump(exclude={"frames"}) | {"path": folder}
            try:
                scene = PhotosScene(PhotosSettings.model_validate(photos), self.context).load()
            except SceneError as error:
                fix = (
                    f"take more than {settings.frames} frames, --set scene.frames=N; or {error.fix}"
                )
                raise SceneError(error.what, where=str(video), fix=fix) from error
            names = ", ".join(sorted(path.stem.removeprefix("frame_") for path in folder.iterdir()))
        return replace(scene, facts=(*scene.facts, Fact("frames_of_the_video", names)))


def _longer_side(video: Path) -> float:
    """Return the longer side of a video's frames in pixels; 0 if it is not a video."""
    import cv2

    opened = cv2.VideoCapture(str(video))
    return max(opened.get(cv2.CAP_PROP_FRAME_WIDTH), opened.get(cv2.CAP_PROP_FRAME_HEIGHT))


def _extract(video: Path, wanted: int, folder: Path) -> None:
    """Write the chosen frames of a video into an empty folder, from the cache if they are there."""
    if not video.is_file():
        raise SceneError("the video does not exist", where=str(video), fix="correct `path`")

    def copy(entry: Path) -> bool:
        for path in entry.glob("frame_*.png"):
            shutil.copy(path, folder)
        return True

    cache, key = Cache("frames"), _key(video, wanted)
    if cache.load(key, copy):
        return
    _log.info("choosing %d frames of %s", wanted, video.name)
    candidates = _candidates(video, wanted)
    if len(candidates) < min(wanted, _MIN_FRAMES):
        raise SceneError(
            f"only {counted(len(candidates), 'frame')} of the video differ: the camera does not move",
            where=str(video),
            fix="walk around the subject while you film, or give a folder of photographs",
        )
    if len(candidates) < wanted:
        _log.info("only %d frames that were looked at differ from the one before", len(candidates))
    _write(video, set(chosen_frames(candidates, wanted)), folder)
    cache.save(key, lambda entry: shutil.copytree(folder, entry, dirs_exist_ok=True))


def _key(video: Path, wanted: int) -> str:
    import cv2

    with video.open("rb") as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()
    code = source_digest(chosen_frames, Impression)
    return content_key(digest, str(wanted), cv2.__version__, code)


class Candidate(NamedTuple):
    """A frame that may be chosen.

    Args:
        number: of the frame, from 0.
        sharpness: variance of the Laplacian.
        motion: mean length of the optical flow since the previous candidate, as a share of the frame.
    """

    number: int
    sharpness: float
    motion: float


def chosen_frames(candidates: Sequence[Candidate], wanted: int) -> list[int]:
    """Return the numbers of the chosen frames, in order; all if there are fewer than wanted.

    The motion of the whole clip is divided into equal parts. Of the candidates in the middle half of each
    part, the sharpest is chosen; without any, the candidate nearest to the part's middle.
    """
    import numpy as np

    if len(candidates) <= wanted:
        return [frame.number for frame in candidates]
    position = np.cumsum([max(frame.motion, _MIN_MOTION) for frame in candidates])
    position = (position - position[0]) / (position[-1] - position[0]) * wanted
    chosen = set()
    for part in range(wanted):
        distances = np.abs(position - (part + 0.5))
        middle = np.flatnonzero(distances <= 0.25)
        if len(middle):
            best = max(middle.tolist(), key=lambda k: (candidates[k].sharpness, -k))
        else:
            best = int(np.argmin(distances))
        chosen.add(candidates[best].number)
    return sorted(chosen)


def _candidates(video: Path, wanted: int) -> list[Candidate]:
    """Candidates that differ from the one before; of those that show the same, the sharpest."""
    import cv2
    import numpy as np
    from PIL import Image

    flow = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_FAST)
    before: Pixels | None = None
    found: list[Candidate] = []
    last: Impression | None = None
    for number, frame in _frames(video, CANDIDATES * wanted):
        grey = _reduced(cv2.cvtColor(frame, cv2.COLOR_BGR2GRAY), _SHARPNESS_SIZE)
        sharpness = float(cv2.Laplacian(grey, cv2.CV_64F).var())
        shown = Impression.of(Image.fromarray(grey))
        if last is not None and shown.is_copy_of(last):
            if sharpness > found[-1].sharpness:
                found[-1] = found[-1]._replace(number=number, sharpness=sharpness)
            continue
        small, motion = _reduced(grey, _MOTION_SIZE), 0.0
        if before is not None:
            moved = flow.calc(before, small, np.zeros((*small.shape, 2), np.float32))
            motion = float(np.linalg.norm(moved, axis=2).mean() / max(small.shape))
        found.append(Candidate(number, sharpness, motion))
        before, last = small, shown
    if not found:
        raise SceneError("the video has no frame that can be read", where=str(video), fix=_FIX)
    return found


def _reduced(grey: cv2.typing.MatLike, size: int) -> Pixels:
    """The picture `[H, W]` with a longer side of at most `size` pixels."""
    import cv2
    import numpy as np

    scale = min(1.0, size / max(grey.shape))
    if scale < 1:
        grey = cv2.resize(grey, None, None, scale, scale, cv2.INTER_AREA)
    return np.asarray(grey, np.uint8)


def _write(video: Path, numbers: set[int], folder: Path) -> None:
    import cv2
    from PIL import Image

    for number, frame in _frames(video, None, numbers):
        picture = Image.fromarray(cv2.cvtColor(frame, cv2.COLOR_BGR2RGB))
        picture.save(folder / f"frame_{number:06d}.png", compress_level=1)


def _frames(
    video: Path, about: int | None, numbers: set[int] | None = None
) -> Iterator[tuple[int, cv2.typing.MatLike]]:
    """Yield frames, upright, with their numbers: about as many as given, evenly spaced, or those given.

    Raises:
        SceneError: the file is not a video.
    """
    import cv2

    capture = cv2.VideoCapture(str(video), cv2.CAP_FFMPEG)
    try:
        if not capture.isOpened():
            raise SceneError("the file cannot be read as a video", where=str(video), fix=_FIX)
        capture.set(cv2.CAP_PROP_ORIENTATION_AUTO, 1)
        count = int(capture.get(cv2.CAP_PROP_FRAME_COUNT))  # an estimate; 0 if unknown
        every = max(1, count // about) if about else 1
        number = 0
        while capture.grab():
            if number in numbers if numbers is not None else number % every == 0:
                decoded, frame = capture.retrieve()
                if decoded:
                    yield number, frame
            number += 1
    finally:
        capture.release()
