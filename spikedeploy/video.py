"""MP4 files through PyAV: frames in, one H.264 file out, written atomically."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from spikedeploy.files import replacing

if TYPE_CHECKING:
    from av.container import OutputContainer
    from av.video.stream import VideoStream

Frame = NDArray[np.uint8]
_FPS = 25  # nearest possible; rendering takes most of the time


@dataclass(frozen=True)
class Pace:
    """The frame rate of a video that runs in real time.

    every  control steps between two frames
    fps    frames of a second
    """

    every: int
    fps: float

    @classmethod
    def of(cls, control_dt: float) -> "Pace":
        """The pace nearest to FPS for a control step of so many seconds."""
        every = max(1, round(1 / (_FPS * control_dt)))
        return cls(every, 1 / (every * control_dt))


@contextmanager
def mp4(path: Path, fps: float, remark: str = "") -> Iterator[Callable[[Frame], None]]:
    """A function that takes frames (H, W, 3) uint8; `path` appears when the block succeeds.

    remark  in the file's metadata
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


def captioned(frame: Frame, text: str) -> Frame:
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
