"""The server's end of the pipe to the eye: starts it, asks it, gives up in time, and starts it again."""

from __future__ import annotations

import contextlib
import json
import logging
import os
import queue
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any, Callable

from ..core.errors import MoopError
from .pipe import receive, send

log = logging.getLogger("octoprint.plugins.moop.eye")

_PACKAGE_PARENT = str(Path(__file__).resolve().parents[2])


class EyeGone(MoopError):
    """The eye died, or did not answer in time and was ended. What it knew of the print is lost with it."""

    code = "eye"


class Interrupted(MoopError):
    """Whoever asked does not want the answer any more."""

    code = "interrupted"


@dataclass
class _Question:
    """turn_s : when it was put to the eye (monotonic); None while it waits for those before it."""

    head: dict[str, Any]
    blobs: Sequence[bytes]
    turn_s: float | None = None
    answered: threading.Event = field(default_factory=threading.Event)
    answer: tuple[dict[str, Any], list[bytes]] | None = None  # None once answered: the eye has gone


@dataclass(frozen=True)
class _Owed:
    """A question whose answer nobody waits for any more, and what it would have been given up by."""

    question: _Question
    timeout_s: float
    tells: bool


class EyeLink:
    """One child process at a time, started when it is first asked and after each death. Safe for several threads.

    rest_s : after so long without a question the process ends by itself, and its memory is given back; None for never
    births : counts the processes so far: who keeps something in the eye asks by it, to learn that it is gone
    """

    def __init__(self, module: str = "octoprint_moop.machine.eye", rest_s: float | None = None) -> None:
        self._module, self._rest_s = module, rest_s
        self._lock = threading.Lock()
        self._child: _Child | None = None
        self._next_id = 0
        self.births = 0

    def ask(
        self,
        do: str,
        *blobs: bytes,
        timeout_s: float,
        interrupted: threading.Event | None = None,
        progress: Callable[[float], None] | None = None,
        birth: int | None = None,
        **arguments: Any,
    ) -> tuple[dict[str, Any], list[bytes]]:
        """The eye's answer: JSON and bytes.

        progress : called now and then, by the thread that asks, with the ratio done, where the eye tells it, be it of what
        it was asked before; the time allowed begins anew with each
        birth : ask this process and no later one, for a question about what only it knows
        Raises the eye's own MoopError; EyeGone where it dies, is ended for taking longer than `timeout_s`, counted from this
        question's turn, or is not the one of that `birth` any more; Interrupted soon after `interrupted` is set (the eye
        goes on, its answer is dropped); MoopError where a number among the arguments is not one.
        """
        try:
            json.dumps(arguments, allow_nan=False)
        except ValueError:
            raise MoopError("Among the numbers is one that is none (NaN, or infinite). Send finite numbers.") from None
        with self._lock:
            if birth is not None and (birth != self.births or self.pid is None):
                raise EyeGone("The process that looks at the pictures ended and was started anew.")
            if self._child is None or not self._child.alive:
                if self._child is not None and not self._child.rests:
                    log.warning("The process that looks at the pictures ended: %s", self._child.last_words())
                if self._child is not None:
                    self._child.kill()  # its thread may still wait for a question
                self._child = None
                self._child = self._born()
            child = self._child
            self._next_id += 1
            question = _Question({"id": self._next_id, "do": do, "arguments": arguments}, blobs)
            child.questions.put(question)
        told, tells = None, progress is not None
        while not question.answered.wait(0.02 if interrupted is not None else min(0.5, timeout_s)):
            if interrupted is not None and interrupted.is_set():
                child.owed = [_Owed(question, timeout_s, tells), *child.owed]
                raise Interrupted(f"Nobody waits any more for the answer to {do!r}.")
            if progress is not None and child.progress not in (None, told):
                told = child.progress
                progress(told or 0.0)
            if child.is_due(question, timeout_s, tells):
                child.kill()
                raise EyeGone(f"Looking took longer than {timeout_s:.0f} s and was given up.")
            if child.is_late:
                child.kill()
                raise EyeGone("The process that looks at the pictures hung and was ended.")
            if not child.alive and not question.answered.wait(1.0):  # asked in the moment of its death
                break
        if question.answer is None:
            raise EyeGone(f"The process that looks at the pictures ended ({child.last_words()}).")
        return _result(do, *question.answer)

    def _born(self) -> _Child:
        """Raises EyeGone where the machine has no room for it: no memory, no disk, no process more."""
        try:
            child = _Child(self._module, self._lock, self._rest_s)
        except OSError as error:
            why = error.strerror or error
            raise EyeGone(f"The process that looks at the pictures cannot be started ({why}).") from None
        self.births += 1
        return child

    @property
    def pid(self) -> int | None:
        """Of the living process; None where there is none."""
        child = self._child
        return child.pid if child is not None and child.alive else None

    def close(self) -> None:
        """End the process. A later question starts a new one."""
        with self._lock:
            child, self._child = self._child, None
        if child is not None:
            child.kill()


def _result(do: str, head: dict[str, Any], blobs: list[bytes]) -> tuple[dict[str, Any], list[bytes]]:
    if "error" in head:
        error = head["error"]
        kinds = {kind.code: kind for kind in MoopError.__subclasses__()}
        raise kinds.get(error["code"], MoopError)(error["message"])
    if "bug" in head:
        log.error("The eye could not answer %r:\n%s", do, head["traceback"])
        raise MoopError(f"Looking failed ({head['bug']}). The log has the details; please report them.")
    return head["result"], blobs


class _Child:
    """One life of the process, with the thread that writes its questions and reads its answers, one after the other.

    asking   : held by whoever puts a question
    rests    : it has ended by itself, since nobody asked it anything for `rest_s`
    owed     : questions whose answers nobody waits for any more; an eye that hangs on one of them would keep all later
    ones waiting
    progress : the ratio done that the eye told last of what it does, None where it has told none
    """

    def __init__(self, module: str, asking: threading.Lock, rest_s: float | None) -> None:
        # From the package's own parent folder, so that the same package is found however the server found it, and
        # nothing in the server's working folder can stand in for a module.
        path = os.pathsep.join(filter(None, (_PACKAGE_PARENT, os.environ.get("PYTHONPATH"))))
        self._errors: IO[bytes] = tempfile.TemporaryFile()  # noqa: SIM115  lives as long as the process
        self._process = subprocess.Popen(
            [sys.executable, "-m", module],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=self._errors, cwd=_PACKAGE_PARENT,
            env={**os.environ, "PYTHONPATH": path},
        )  # fmt: skip
        self.pid = self._process.pid
        self._given_up = self.rests = False
        self._asking, self._rest_s = asking, rest_s
        self.questions: queue.SimpleQueue[_Question | None] = queue.SimpleQueue()
        self.owed: list[_Owed] = []
        self.progress: float | None = None
        self._told_s = 0.0
        threading.Thread(target=self._converse, name="moop.eye", daemon=True).start()

    @property
    def alive(self) -> bool:
        """Whether it runs and is to be asked: it may have been killed (out of memory) while nobody asked it anything."""
        return not self._given_up and self._process.poll() is None

    def is_due(self, question: _Question, timeout_s: float, tells: bool) -> bool:
        """Whether it has had its time. tells : each word of progress gives it more."""
        if question.turn_s is None:  # what is before it has a time of its own
            return False
        return time.monotonic() > (max(question.turn_s, self._told_s) if tells else question.turn_s) + timeout_s

    @property
    def is_late(self) -> bool:
        self.owed = [owed for owed in self.owed if not owed.question.answered.is_set()]
        return any(self.is_due(owed.question, owed.timeout_s, owed.tells) for owed in self.owed)

    def kill(self) -> None:
        self._given_up = True
        self._process.kill()
        self.questions.put(None)

    def last_words(self) -> str:
        """How it ended and the last line that it wrote to standard error."""
        code = self._process.poll()
        how = f"signal {-code}" if code is not None and code < 0 else f"status {code}"
        try:
            size = self._errors.seek(0, os.SEEK_END)
            self._errors.seek(max(size - 2000, 0))
            lines = self._errors.read().decode(errors="replace").strip().splitlines()
        except (OSError, ValueError):
            lines = []
        return f"{how}: {lines[-1][:200]}" if lines else how

    def _converse(self) -> None:
        question: _Question | None = None
        assert self._process.stdin is not None and self._process.stdout is not None
        try:
            while (question := self._next()) is not None:
                question.turn_s = time.monotonic()
                send(self._process.stdin, question.head, question.blobs)
                head: dict[str, Any] = {}
                while head.get("id") != question.head["id"]:
                    head, blobs = receive(self._process.stdout)
                    if "progress" in head:
                        self.progress, self._told_s = head["progress"], time.monotonic()
                        head = {}
                self.progress = None
                question.answer = (head, blobs)
                question.answered.set()
        except (EOFError, OSError):
            pass
        except Exception:
            log.exception("The conversation with the eye broke off")
        finally:
            self._given_up = True
            self._process.kill()
            self._process.wait()
            for stream in (self._process.stdin, self._process.stdout):
                with contextlib.suppress(OSError):
                    stream.close()
            if question is not None:
                question.answered.set()
            self._drop_the_rest()

    def _next(self) -> _Question | None:
        """The next question; None where there will be none."""
        while True:
            try:
                return self.questions.get(timeout=self._rest_s)
            except queue.Empty:
                with self._asking:
                    if self.questions.empty():
                        self._given_up = self.rests = True
                        return None

    def _drop_the_rest(self) -> None:
        while True:
            try:
                waiting = self.questions.get_nowait()
            except queue.Empty:
                return
            if waiting is not None:
                waiting.answered.set()
