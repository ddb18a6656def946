"""The eye: the child process that does all the looking. `python -m octoprint_moop.machine.eye`, spoken to over pipes.

Parsing a big file in Python, drawing and a GL driver's crash must not touch the server that feeds a printer, so they
happen here: niced, with one thread that owns the GL context. The eye ends when its standard input does. Everything
that it knows of a print can be rebuilt from the job and the recording on disk.
"""

from __future__ import annotations

import os

# Before cv2 and NumPy are imported: a small picture file that unfolds to gigabytes is refused, and cores are left to
# the server.
os.environ.setdefault("OPENCV_IO_MAX_IMAGE_PIXELS", str(30_000_000))
os.environ.setdefault("OMP_NUM_THREADS", "2")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # our matrices are small: more threads only wait for each other

import contextlib
import errno
import gzip
import shutil
import sys
import threading
import time
import traceback
from dataclasses import asdict
from pathlib import Path
from typing import IO, Any, Callable

import cv2

from ..core.errors import MoopError, RecordingError
from ..core.gcode.read import read_gcode
from ..core.header import Header, Moment
from ..core.inspection import Inspector
from ..core.settings import read_settings
from ..core.toolpath import Toolpath
from ..core.view.usable import is_still
from . import bench
from .beginning import bare_ends
from .bench import Answer
from .jobtext import job_text
from .lasting import LastingRenderer
from .parking import Modes, read_modes
from .passing import Reported, place
from .pictures import decode, encode_mask
from .pipe import receive, send
from .recording import Recording
from .renderers import open_renderer
from .roads import MeshChoice, Road, find_road

REBUILT_CHECKS = 300
TELL_EVERY_S = 0.5
PACKING_S = 0.3


class Eye:
    """What the eye can be asked. Each public method is one question; arguments and answers are JSON and bytes.

    progress : called with the ratio done, 0 to 1, while a file is read
    """

    def __init__(self, progress: Callable[[float], None] = lambda ratio: None) -> None:
        self._progress = progress
        self._inspector: Inspector | None = None
        self._road: Road | None = None
        self._job: Path | None = None
        self._renderer_stack = contextlib.ExitStack()
        self._renderer: LastingRenderer | None = None

    def index(self, blobs: list[bytes], job: str, cache: str) -> Answer:
        """Get ready for a G-code file that will probably be printed, so that `open` is quick: layers, renderer."""
        return {"layers": self._read(job, cache).layers, "renderer": self._draw().name}, []

    def open(
        self,
        blobs: list[bytes],
        job: str | None,
        header: dict[str, Any],
        settings: dict[str, Any],
        cache: str,
        mesh: dict[str, Any] | None = None,
        keep_as: str | None = None,
        keep_mesh_as: str | None = None,
        recording: str | None = None,
        said: dict[str, str] | None = None,
    ) -> Answer:
        """Get ready to watch a print: read the G-code and make the inspector.

        job       : path of the G-code file, None where there is none
        mesh      : the model to compare with, as MeshChoice reads it; None for the G-code alone
        settings  : the user's choices, by name
        blobs     : the empty bed's picture, JPEG, or nothing
        keep_as   : where to put a packed copy of the job, for the recording
        keep_mesh_as : where to put the mesh as placed, likewise
        recording : a recording's folder, to learn again what was known of this print before the eye was restarted
        said      : what the user said after which of its frames: `accept` or `pardon`
        Answers road (gcode, mesh or height), layers, ends (file position of each layer's end; none by height),
        bare_ends (positions at which nothing lies yet), bounds_mm, objects, cancel_commands, modes (each once) and mode_of
        (which of them holds at each of all these positions), notes, renderer.
        """
        self._inspector = self._road = None  # the memory of two large prints at a time would be too much
        path = None if job is None else Path(job)
        road = find_road(path, None if mesh is None else MeshChoice.from_json(mesh), Path(cache), self._progress)
        toolpath = road.toolpath
        ends: list[int] = []
        bare: list[int] = []
        modes: list[Modes] = []
        if path is not None and road.name != "height":
            with job_text(path) as text:
                ends, bare = toolpath.layer_end_pos.tolist(), bare_ends(text, int(toolpath.end_pos[0]))
                modes = read_modes(text, [*bare, *ends])
        if path is not None and keep_as and not Path(keep_as).exists():
            packing = threading.Thread(target=_pack, args=(open(path, "rb"), Path(keep_as)), daemon=True)  # noqa: SIM115
            packing.start()
            packing.join(PACKING_S)  # a large file is packed beside the first checks
        if road.solid is not None and keep_mesh_as:
            with contextlib.suppress(OSError):  # a full disk costs the recording, never the check
                Path(keep_mesh_as).write_bytes(road.solid.stl())
        kinds = {one: number for number, one in enumerate(dict.fromkeys(modes))}
        reference = decode(blobs[0]) if blobs else None
        self._road, self._job = road, path
        self._inspector = Inspector(
            Header.from_json(header), toolpath, road.drawn_by(self._draw()), read_settings(settings), reference
        )
        self._inspector.draw_ahead()
        notes = [*road.notes]
        if recording:
            try:
                self._learn_again(Recording.open(recording), said or {})
            except RecordingError as error:
                notes.append(f"What was known of this print cannot be learned again. {error}")
        answer = {
            "road": road.name,
            "layers": toolpath.layers,
            "ends": ends,
            "bare_ends": bare,
            "bounds_mm": toolpath.bounds_mm().tolist(),
            "objects": list(toolpath.objects),
            "cancel_commands": list(toolpath.cancel_commands),
            # an object for each layer would have the server's garbage collector stop all of its threads for a while
            "modes": [one.to_json() for one in kinds],
            "mode_of": [kinds[one] for one in modes],
            "notes": notes,
            "renderer": self._draw().name,
        }
        toolpath.let_go()
        return answer, []

    def reference(self, blobs: list[bytes], moment: dict[str, Any]) -> Answer:
        """The bed just before anything lies on it. blobs: the frame, JPEG. `taken` is false where the head hides it."""
        inspector, road = self._opened()
        return {"taken": inspector.take_reference(decode(blobs[0]), road.moment(Moment.from_json(moment)))}, []

    def check(self, blobs: list[bytes], moment: dict[str, Any]) -> Answer:
        """One check of the print that is open. blobs: the frame, JPEG."""
        inspector, road = self._opened()
        check = inspector.check(decode(blobs[0]), road.moment(Moment.from_json(moment)))
        road.toolpath.let_go()
        return check.to_json(), []

    def learn(self) -> None:
        """After the answer has gone out: what the printer did not have to wait for."""
        if self._inspector is not None and self._road is not None:
            self._inspector.learn()
            self._road.toolpath.let_go()

    def still(self, blobs: list[bytes]) -> Answer:
        """Whether nothing has moved between two frames. blobs: both, JPEG."""
        return {"still": is_still(decode(blobs[0]), decode(blobs[1]))}, []

    def place(
        self, blobs: list[bytes], done_bytes: int, most_bytes: int, total_bytes: int, position_mm: list[float]
    ) -> Answer:
        """Where a print stands that the printer reads from its own storage: file_pos, sure_pos, layer, known; and
        laid, how many beads lie for sure. The arguments are those of `Reported`."""
        _, road = self._opened()
        assert self._job is not None
        x, y, z = position_mm
        found = place(road.toolpath, self._job, Reported(done_bytes, most_bytes, total_bytes, (x, y, z)))
        return {**asdict(found), "laid": road.toolpath.laid_at(found.sure_pos)}, []

    def accept(self, blobs: list[bytes]) -> Answer:
        """The user goes on with the print as the last check saw it."""
        self._opened()[0].accept()
        return {}, []

    def pardon(self, blobs: list[bytes]) -> Answer:
        """The user says that what the last check saw is no failure."""
        self._opened()[0].pardon()
        return {}, []

    def pictures(self, blobs: list[bytes]) -> Answer:
        """The masks of the last check as PNGs: seen, expected, ignored. No blobs where nothing could be compared.

        Answers renderer, which may be another one by now.
        """
        pictures, told = self._opened()[0].pictures, {"renderer": self._draw().name}
        if pictures is None:
            return told, []
        return told, [encode_mask(mask) for mask in (pictures.observed, pictures.expected, pictures.ignored)]

    def close(self) -> None:
        self._renderer_stack.close()

    def _read(self, job: str, cache: str) -> Toolpath:
        return read_gcode(Path(job), cache_dir=Path(cache), progress=self._progress)

    def _draw(self) -> LastingRenderer:
        if self._renderer is None:
            first = open_renderer()
            self._renderer_stack.enter_context(first)
            self._renderer = LastingRenderer(first)
        return self._renderer

    def _opened(self) -> tuple[Inspector, Road]:
        if self._inspector is None or self._road is None:
            raise MoopError("No print is being watched just now. Start one, then look again.")
        return self._inspector, self._road

    def _learn_again(self, recording: Recording, said: dict[str, str]) -> None:
        inspector, road = self._opened()
        known = recording.moments[-REBUILT_CHECKS:]
        for number, moment in enumerate(known):
            self._progress(number / len(known))
            with contextlib.suppress(MoopError):  # one damaged picture must not cost what the others teach
                inspector.check(recording.frame(moment), road.moment(moment))
            if moment.frame in said:
                getattr(self, said[moment.frame])([])


QUESTIONS = ("index", "open", "reference", "check", "still", "place", "accept", "pardon", "pictures")


def answer(eye: Eye, do: str, blobs: list[bytes], arguments: dict[str, Any]) -> Answer:
    """Raises MoopError where the question has no answer that the user would like."""
    if do in QUESTIONS:
        return getattr(eye, do)(blobs, **arguments)
    return bench.QUESTIONS[do](blobs, **arguments)


def _pack(source: IO[bytes], packed: Path) -> None:
    """A packed copy of an open file, which is closed. It has been opened before, since its name may soon be another's."""
    partial = packed.with_name(packed.name + ".part")
    try:
        with source, gzip.open(partial, "wb", compresslevel=1) as target:
            shutil.copyfileobj(source, target, 1 << 20)
        os.replace(partial, packed)
    except OSError:  # a full disk costs the recording, never the check
        partial.unlink(missing_ok=True)


def _step_back() -> None:
    """The printer, the server and the camera come first; when memory runs out, the eye is what should go."""
    with contextlib.suppress(AttributeError, OSError):  # and never in the server's place when it wakes
        os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))
    if hasattr(os, "nice"):
        os.nice(10)
    with contextlib.suppress(OSError):
        Path("/proc/self/oom_score_adj").write_text("500")
    cv2.setNumThreads(2)


def _for_want_of_memory(error: BaseException | None) -> bool:
    """Whether that is what an error comes from, whatever was made of it on its way."""
    while error is not None:
        if isinstance(error, MemoryError) or (isinstance(error, OSError) and error.errno == errno.ENOMEM):
            return True
        if isinstance(error, cv2.error) and error.code == cv2.Error.StsNoMem:
            return True
        error = error.__context__
    return False


def _afterwards(eye: Eye) -> None:
    """What could not be learned costs the checks to come a little, and nobody waits for an answer."""
    try:
        eye.learn()
    except Exception as error:
        if _for_want_of_memory(error):
            raise MemoryError(f"{type(error).__name__}: {error}") from None
        traceback.print_exc()


def main() -> int:
    questions = sys.stdin.buffer
    answers = os.fdopen(os.dup(sys.stdout.fileno()), "wb")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())  # what a library prints must not tear an answer apart
    _step_back()
    head: dict[str, Any] = {}
    told_s = 0.0

    def progress(ratio: float) -> None:
        nonlocal told_s
        if time.monotonic() - told_s > TELL_EVERY_S:
            told_s = time.monotonic()
            send(answers, {"id": head["id"], "progress": round(ratio, 3)})

    eye = Eye(progress)
    try:
        while True:
            try:
                head, blobs = receive(questions)
            except EOFError:
                return 0
            try:
                result, out = answer(eye, head["do"], blobs, head["arguments"])
                send(answers, {"id": head["id"], "result": result}, out)
            except BrokenPipeError:
                raise
            except Exception as error:
                if _for_want_of_memory(error):  # this process ends: the next one begins with all that there is
                    raise MemoryError(f"{type(error).__name__}: {error}") from None
                if isinstance(error, MoopError):
                    send(answers, {"id": head["id"], "error": {"code": error.code, "message": str(error)}})
                    continue
                # a bug of ours: the server logs it, and the next question may go well
                trace = traceback.format_exc()
                send(answers, {"id": head["id"], "bug": f"{type(error).__name__}: {error}", "traceback": trace})
            _afterwards(eye)
    except BrokenPipeError:
        return 0
    finally:
        eye.close()


if __name__ == "__main__":
    sys.exit(main())
