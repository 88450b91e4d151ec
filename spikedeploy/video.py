"""Videos from frames, written atomically: H.264 in MP4 through PyAV; a frame as WebP."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from fractions import Fraction
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.files import replacing

if TYPE_CHECKING:
    from av.container import OutputContainer
    from av.video.stream import VideoStream

Frame = NDArray[np.uint8]
_FPS = 25  # nearest possible; rendering takes most of the time
_UNKNOWN = 1 / 30  # [s] control step where an environment does not say


@dataclass(frozen=True)
class Pace:
    """The frame rate of a video that runs in real time.

    every: control steps between two frames
    fps: frames of a second
    """

    every: int
    fps: float

    @classmethod
    def for_period(cls, control_dt: float | None) -> "Pace":
        """The pace nearest to FPS for a control step of so many seconds, if that is known."""
        period = control_dt or _UNKNOWN
        every = max(1, round(1 / (_FPS * period)))
        return cls(every, 1 / (every * period))


@contextmanager
def mp4(path: Path, fps: float, remark: str = "") -> Iterator[Callable[[Frame], None]]:
    """A function that takes frames (H, W, 3) uint8; `path` appears when the block succeeds.

    remark: in the file's metadata
    """
    import av

    streams: list[VideoStream] = []  # created with the size of the first frame
    with (
        replacing(path) as part,
        av.open(part, "w", format="mp4", options={"movflags": "faststart"}) as file,
    ):
        if remark:
            file.metadata["comment"] = remark

        def write(frame: Frame) -> None:
            even = frame[: frame.shape[0] // 2 * 2, : frame.shape[1] // 2 * 2]  # yuv420 halves
            if not streams:
                streams.append(_stream(file, even, fps))
            image = av.VideoFrame.from_ndarray(np.ascontiguousarray(even), format="rgb24")
            file.mux(streams[0].encode(image))

        yield write
        for stream in streams:
            file.mux(stream.encode())  # frames still in the encoder


def _stream(file: "OutputContainer", frame: Frame, fps: float) -> "VideoStream":
    """A one-threaded H.264 stream of the frame's size, in the most widely supported format."""
    rate = Fraction(fps).limit_denominator(1000)
    stream = file.add_stream("libx264", rate=rate, options={"crf": "23", "threads": "1"})
    stream.height, stream.width = frame.shape[:2]
    stream.pix_fmt = "yuv420p"
    return stream


def shrink(frame: Frame, width: int) -> Frame:
    """A copy of the frame, at most so wide."""
    from PIL import Image

    image = Image.fromarray(frame)
    image.thumbnail((width, frame.shape[0]))
    small: Frame = np.array(image)
    return small


def webp(frame: Frame) -> bytes:
    """The frame as a picture, compressed with losses that one hardly sees."""
    from PIL import Image

    memory = BytesIO()
    Image.fromarray(frame).save(memory, format="WEBP", quality=70)
    return memory.getvalue()


def add_caption(frame: Frame, text: str) -> Frame:
    """The frame (H, W, 3) with a dark strip that holds `text` along its lower edge."""
    from PIL import Image, ImageDraw, ImageFont

    image = Image.fromarray(frame)
    height = max(18, frame.shape[0] // 14)
    strip = Image.new("RGB", (frame.shape[1], height), (24, 28, 36))
    font = ImageFont.load_default(size=height * 0.62)
    middle = (frame.shape[1] / 2, height / 2)
    ImageDraw.Draw(strip).text(middle, text, font=font, fill=(235, 238, 245), anchor="mm")
    image.paste(strip, (0, frame.shape[0] - height))
    return np.asarray(image, dtype=np.uint8)
