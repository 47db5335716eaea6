"""The table in motion: a page with a scene to turn and to play, and a film."""

import io
from collections.abc import Iterator, Sequence
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path

import numpy as np

from tiltcal.core.files import replacing, write_text
from tiltcal.core.optional_library import library
from tiltcal.laboratory.scene import Scene

PAINT = ((92, 102, 120), (191, 120, 56), (64, 128, 189), (89, 153, 102), (148, 115, 178))
SUBJECT = (219, 79, 69)


def write_scene(path: Path, scene: Scene, labels: Sequence[str], rate_hz: float) -> None:
    """Write a page with the table in motion and the program that draws it; it opens offline.

    Args:
        path: of the HTML file.
        scene: the table's solids at each instant.
        labels: a label for each instant.
        rate_hz: instants a second of playing.

    Raises:
        TiltcalError: the library that makes the page is not installed.
    """
    viser = library("viser", "view", "page of the table in motion")
    with redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()):
        server = viser.ViserServer(host="127.0.0.1", verbose=False)
        try:
            text = _played(server, scene, labels, rate_hz)
        finally:
            server.stop()
    write_text(path, text)


def _played(server: "object", scene: Scene, labels: Sequence[str], rate_hz: float) -> str:
    """The page of a scene that a server receives frame by frame."""
    from scipy.spatial.transform import Rotation

    shown = server.scene  # type: ignore[attr-defined]
    parts = [p for p in dict.fromkeys(s.part for s in scene.solids) if p != "instrument"]
    colours = dict(zip(parts, PAINT, strict=False)) | {"instrument": SUBJECT}
    turns = Rotation.from_matrix(scene.rotations.reshape(-1, 3, 3)).as_quat(scalar_first=True)
    turns = turns.reshape(*scene.positions.shape[:2], 4)
    solids = [
        shown.add_mesh_simple(
            f"/{s.part}/{k}", s.corners(), s.faces(), color=colours[s.part], flat_shading=True
        )
        for k, s in enumerate(scene.solids)
    ]
    shown.set_up_direction("+z")
    camera = server.initial_camera  # type: ignore[attr-defined]
    camera.position, camera.look_at = (1.1, -1.3, 0.5), (0.0, 0.0, -0.1)
    shown.add_grid("/floor", width=2.0, height=2.0, position=(0.0, 0.0, -0.55))
    label = shown.add_label("/label", labels[0], position=(0.0, 0.0, 0.45))
    played = server.get_scene_serializer()  # type: ignore[attr-defined]
    for n, text in enumerate(labels):
        for k, solid in enumerate(solids):
            solid.position, solid.wxyz = scene.positions[n, k], turns[n, k]
        label.text = text
        played.insert_sleep(1.0 / rate_hz)
    return str(played.as_html())


def write_film(path: Path, pictures: Iterator[bytes], width: int, height: int, rate_hz: int) -> int:
    """Write a film, H.264 in MP4, and return its number of pictures.

    Args:
        path: of the file.
        pictures: RGB, row by row.
        width, height: of each, px.
        rate_hz: pictures a second.

    Raises:
        TiltcalError: the library that encodes is not installed.
    """
    av = library("av", "film", "film of the table in motion")
    count = 0
    with replacing(path) as temporary:
        options = {"movflags": "faststart"}
        with av.open(str(temporary), "w", format="mp4", options=options) as file:
            stream = file.add_stream("libx264", rate=rate_hz, options={"crf": "22"})
            stream.width, stream.height, stream.pix_fmt = width, height, "yuv420p"
            for picture in pictures:
                pixels = np.frombuffer(picture, np.uint8).reshape(height, width, 3)
                frame = av.VideoFrame.from_ndarray(pixels, format="rgb24")
                file.mux(stream.encode(frame))
                count += 1
            file.mux(stream.encode())
    return count
