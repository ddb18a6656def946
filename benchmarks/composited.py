"""Faults and nuisances put into prints that went well, pixel by pixel, with the true masks changed alike.

A recording with true masks (`frames/NNNNNN.mask.png`) lends its pictures: their light, noise, lens and colours stay, and
only what a fault changes is moved, frozen or painted over. So one good recording makes hundreds of bad ones.
A print that the demo's webcam painted lends its pictures just so.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np

from octoprint_moop.core.camera import Camera
from octoprint_moop.core.gcode.read import read_gcode
from octoprint_moop.core.header import Header, Moment
from octoprint_moop.core.toolpath import Role, Toolpath
from octoprint_moop.machine.recording import Recording

FAULTS = (
    "extrusion", "under_extrusion", "detachment", "tip_over", "layer_shift", "warping", "spaghetti", "sagging", "blob",
)  # fmt: skip
FIRST_LAYER_FAULTS = ("nothing", "dragged", "one_missing")  # from the print's first bead on
NUISANCES = (
    "dim", "uneven", "white_balance", "gamma", "nudge", "knock", "hand", "head", "alike", "jpeg", "hairs", "black", "frozen",
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class Base:
    """A print's good part. frames: (n, H, W, 3) uint8; masks: (n, H, W) bool; born: (H, W) first layer with matter."""

    name: str
    header: Header
    toolpath: Toolpath
    moments: tuple[Moment, ...]
    frames: np.ndarray
    masks: np.ndarray
    reference: np.ndarray
    totals: np.ndarray

    @classmethod
    def open(cls, folder: Path) -> Base:
        recording = Recording.open(folder)
        with recording.job_path() as path:
            toolpath = read_gcode(path)
        truth = json.loads((folder / "truth.json").read_text())
        fault = truth.get("fault")
        good = fault["onset_layer"] if fault else len(recording.moments)
        moments = recording.moments[:good]
        masks = [
            cv2.imread(str(folder / m.frame.replace(".jpg", ".mask.png")), cv2.IMREAD_GRAYSCALE) > 0 for m in moments
        ]
        frames = np.stack([recording.frame(m) for m in moments])
        totals = np.array([row["total_px"] for row in truth["per_frame"][:good]])
        return cls(
            folder.name, recording.header, toolpath, moments, frames, np.stack(masks), recording.reference(), totals
        )

    @property
    def camera(self) -> Camera:
        return self.header.camera()

    def covered(self, moment: Moment, beads: np.ndarray) -> np.ndarray:
        """(H, W) bool: pixels that these beads cover, drawn as thick lines."""
        shift = self.header.printer.bed.room_from_print_mm(moment.position_mm)
        picture = np.zeros(self.reference.shape[:2], np.uint8)
        ends = self.toolpath.beads_mm[beads, :6].astype(float).reshape(-1, 3) + shift
        pixels = np.nan_to_num(self.camera.project(ends), nan=-1e4).reshape(-1, 4)
        depth = self.camera.camera_from_room[2, :3] @ ends[::2].T + self.camera.camera_from_room[2, 3]
        thick = np.maximum(np.round(self.toolpath.beads_mm[beads, 6] * self.camera.K[0, 0] / depth), 2).astype(int)
        for (x0, y0, x1, y1), width in zip(np.round(pixels).astype(int).tolist(), thick.tolist()):
            cv2.line(picture, (x0, y0), (x1, y1), 255, width)
        return cv2.morphologyEx(picture, cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8)) > 0


@dataclass(frozen=True, eq=False)
class Picture:
    """A frame as delivered, (H, W, 3) uint8, the matter truly in it, (H, W) bool, and whether it can be used at all."""

    frame: np.ndarray
    mask: np.ndarray
    usable: bool = True


@dataclass(eq=False)
class Story:
    """One run: what happens, to which object, from which layer on, how strongly; all drawn from the seed."""

    base: Base
    seed: int
    fault: str | None = None
    nuisances: tuple[str, ...] = ()
    strength: float = 1.0
    onset: int = 0
    object_id: int | None = None
    _rng: np.random.Generator = field(init=False, repr=False)

    def __post_init__(self) -> None:
        self._rng = rng = np.random.default_rng([self.seed, 1])
        count = len(self.base.moments)
        if self.fault and not self.onset and self.fault not in FIRST_LAYER_FAULTS:
            self.onset = int(rng.integers(3, max(4, count - 12)))
        labelled = len(self.base.toolpath.objects)
        if (
            self.fault
            and self.object_id is None
            and labelled > 1
            and self.fault not in ("layer_shift", "nothing")
            and rng.random() < 0.9
        ):
            self.object_id = int(rng.integers(labelled))
        if self.onset > 22 and self.seed % 4:  # most faults come early, so that runs are short
            self.onset = 3 + self.onset % 20
        self.from_layer = int(rng.integers(1, max(2, count - 4)))
        if self.fault:
            toolpath, moment = self.base.toolpath, self.base.moments[-1]
            body = toolpath.object_id >= 0 if (toolpath.object_id >= 0).any() else toolpath.role != Role.BRIM
            if self.object_id is not None:
                body = toolpath.object_id == self.object_id
            self._body = body
            self._region = (
                cv2.dilate(self.base.covered(moment, np.flatnonzero(body)).astype(np.uint8), np.ones((5, 5), np.uint8))
                > 0
            )
        self._draws = {
            key: np.random.default_rng([self.seed, 2, n]).random(8)
            for n, key in enumerate((*FAULTS, *NUISANCES, *FIRST_LAYER_FAULTS))
        }
        self._px = self.base.reference.shape[1] / 640  # a picture half as wide shows everything half as large

    def __len__(self) -> int:
        return len(self.base.moments)

    @property
    def name(self) -> str:
        return self.base.name

    @property
    def header(self) -> Header:
        return self.base.header

    @property
    def toolpath(self) -> Toolpath:
        return self.base.toolpath

    @property
    def reference(self) -> np.ndarray:
        return self.base.reference

    @property
    def object_name(self) -> str | None:
        return None if self.object_id is None else self.toolpath.objects[self.object_id]

    @property
    def size_px(self) -> float | None:
        """How large the fault is where that is a length: shift, lift, slide, radius."""
        draws = self._draws.get(self.fault or "")
        if self.fault == "layer_shift":
            return float((6 + 20 * draws[1]) * self.strength * self._px)
        if self.fault == "warping":
            return float((7 + 12 * draws[2]) * self.strength * self._px)
        if self.fault == "blob":
            return float((8 + 14 * draws[1]) * self.strength * self._px)
        if self.fault == "detachment":
            return float((12 + 50 * draws[1]) * self.strength * self._px)
        return None

    @property
    def px_per_mm(self) -> float:
        """About, in the middle of the print."""
        low, high = self.toolpath.bounds_mm()
        middle = (low + high) / 2
        depth_mm = float((self.base.camera.camera_from_room @ [*middle, 1.0])[2])
        return float(self.base.camera.K[0, 0] / depth_mm)

    def moment(self, number: int) -> Moment:
        return self.base.moments[number]

    def clean_mask(self, number: int) -> np.ndarray:
        return self.base.masks[number]

    def total_px(self, number: int) -> int:
        return int(self.base.totals[number])

    def finished(self, number: int) -> np.ndarray:
        """The same layer of a print that went well: the untouched picture with another exposure's noise."""
        noise = np.random.default_rng([self.seed, 7, number]).normal(0, 3.0, self.base.frames[number].shape)
        return np.clip(self.base.frames[number] + noise, 0, 255).astype(np.uint8)

    def picture(self, number: int) -> Picture:
        """The number-th frame of the run."""
        frame, mask = self.base.frames[number].copy(), self.base.masks[number].copy()
        if self.fault and number >= self.onset:
            frame, mask = getattr(self, "_" + self.fault)(number, frame, mask, self._draws[self.fault])
            noise = np.random.default_rng([self.seed, 3, number]).normal(0, 2.0, frame.shape)
            frame = np.clip(frame + noise, 0, 255).astype(np.uint8)
        usable = True
        for nuisance in self.nuisances:
            frame, good = getattr(self, "_" + nuisance)(number, frame, self._draws[nuisance])
            usable &= good
        return Picture(frame, mask, usable)

    # faults ---------------------------------------------------------------------------------------------------------

    def _extrusion(self, number, frame, mask, draws):
        return self._frozen_at(self.onset - 1, frame, mask)

    def _frozen_at(self, past, frame, mask):
        """The object as it was, everything else as it is."""
        frame, mask = frame.copy(), mask.copy()
        frame[self._region], mask[self._region] = (
            self.base.frames[past][self._region],
            self.base.masks[past][self._region],
        )
        return frame, mask

    def _under_extrusion(self, number, frame, mask, draws):
        past_frame, past_mask = self._frozen_at(self.onset - 1, frame, mask)
        grain = np.random.default_rng([self.seed, 4]).normal(0, 1, mask.shape).astype(np.float32)
        grain = cv2.GaussianBlur(grain, (0, 0), 1.2)
        holes = grain < np.quantile(grain, min(0.9, 0.35 + 0.5 * draws[0] * self.strength))
        holes &= mask & ~past_mask & self._region
        return np.where(holes[..., None], past_frame, frame), np.where(holes, past_mask, mask)

    def _object(self, past):
        return self._region & self.base.masks[past]

    def _moved(self, frame, mask, past, matrix):
        """The object as it was at `past`, moved by a 2 x 3 matrix; the bed where it stood."""
        own = self._object(past)
        rest_frame, rest_mask = frame.copy(), mask & ~self._region
        rest_frame[self._region] = self.base.reference[self._region]
        size = mask.shape[::-1]
        there = cv2.warpAffine(own.astype(np.uint8) * 255, matrix, size) > 127
        picture = cv2.warpAffine(self.base.frames[past], matrix, size, flags=cv2.INTER_LINEAR)
        return np.where(there[..., None], picture, rest_frame), rest_mask | there

    def _detachment(self, number, frame, mask, draws):
        past = self.onset - 1
        rows, columns = np.nonzero(self._object(past))
        middle = (float(columns.mean()), float(rows.mean()))
        matrix = cv2.getRotationMatrix2D(middle, (draws[0] - 0.5) * 70 * self.strength, 1.0)
        reach = self.size_px
        matrix[:, 2] += reach * np.array([np.cos(6.28 * draws[2]), 0.6 * np.sin(6.28 * draws[2])])
        frame, mask = self._moved(frame, mask, past, matrix)
        return self._strands(number, frame, mask, draws[3:], 0.5 * draws[3]) if draws[4] > 0.4 else (frame, mask)

    def _tip_over(self, number, frame, mask, draws):
        past = self.onset - 1
        rows, columns = np.nonzero(self._object(past))
        foot = (float(columns.max() if draws[0] > 0.5 else columns.min()), float(rows.max()))
        angle = (-1 if draws[0] > 0.5 else 1) * (60 + 40 * draws[1]) * self.strength
        return self._moved(frame, mask, past, cv2.getRotationMatrix2D(foot, angle, 0.95))

    def _layer_shift(self, number, frame, mask, draws):
        beads = np.arange(
            self.base.toolpath.layer_start[self.onset], self.base.toolpath.laid_at(self.base.moments[number].file_pos)
        )
        upper = self.base.covered(self.base.moments[number], beads[self._body[beads]]) & mask
        past_frame, past_mask = self._frozen_at(self.onset - 1, frame, mask)
        turn, reach = 1.57 * int(4 * draws[0]), self.size_px
        matrix = np.array([[1, 0, reach * np.cos(turn + 0.5)], [0, 1, 0.6 * reach * np.sin(turn + 0.5)]])
        there = cv2.warpAffine(upper.astype(np.uint8) * 255, matrix, mask.shape[::-1]) > 127
        picture = cv2.warpAffine(frame, matrix, mask.shape[::-1])
        return np.where(there[..., None], picture, past_frame), past_mask | there

    def _warping(self, number, frame, mask, draws):
        base = self._region & self.base.masks[0] & self._object(number)
        rows, columns = np.nonzero(base if base.any() else self._object(number))
        at = [np.argmin(columns), np.argmax(columns), np.argmax(rows)][int(3 * draws[0])]
        rise = min(1.0, (number - self.onset + 1) / (1 + 12 * draws[1]))
        lift = self.size_px * rise
        reach = 0.25 * (np.ptp(columns) + 1) + 5
        y, x = np.mgrid[: mask.shape[0], : mask.shape[1]].astype(np.float32)
        near = ((x - columns[at]) ** 2 + (y + lift * 0.5 - rows[at]) ** 2) / (2 * reach**2)
        field = (lift * np.exp(-near)).astype(np.float32)
        own = self._object(number)
        there = cv2.remap(own.astype(np.uint8) * 255, x, y + field, cv2.INTER_LINEAR) > 127
        picture = cv2.remap(frame, x, y + field, cv2.INTER_LINEAR)
        rest = frame.copy()
        rest[own] = self.base.reference[own]
        return np.where(there[..., None], picture, rest), (mask & ~own) | there

    def _spaghetti(self, number, frame, mask, draws):
        frame, mask = self._frozen_at(self.onset - 1, frame, mask)
        return self._strands(number, frame, mask, draws, 1.0)

    def _sagging(self, number, frame, mask, draws):
        return self._strands(number, frame, mask, draws, 0.25, hanging=True)

    def _strands(self, number, frame, mask, draws, amount, hanging=False):
        """Curled strands of the filament that grow with each layer."""
        rng = np.random.default_rng([self.seed, 5])
        own = self._object(number)
        if not own.any():
            return frame, mask
        rows, columns = np.nonzero(own)
        colours = self.base.frames[number][own]
        edge = np.argwhere(own & ~(cv2.erode(own.astype(np.uint8), np.ones((3, 3))) > 0))
        if hanging:
            edge = edge[edge[:, 0] < np.median(rows) + 5]
        steps = int((60 + 90 * (number - self.onset)) * amount * self.strength) + 10
        frame, drawn = frame.copy(), np.zeros(mask.shape, np.uint8)
        reach = 0.5 * (np.ptp(columns) + np.ptp(rows)) * 0.5 + 12
        middle = np.array([columns.mean(), rows.mean()])
        while steps > 0:
            start = edge[rng.integers(len(edge))][::-1].astype(float)
            length, angle, turn = int(rng.integers(25, 70)), rng.uniform(0, 6.28), rng.normal(0, 0.25)
            tone = colours[rng.integers(len(colours))].astype(float) * rng.uniform(0.75, 1.05)
            points = [start]
            for _ in range(min(length, steps)):
                turn += rng.normal(0, 0.08)
                angle += np.clip(turn, -0.5, 0.5)
                step = np.array([np.cos(angle), np.sin(angle)]) * 1.6
                if hanging:
                    step = np.array([0.7 * np.cos(angle), abs(np.sin(angle)) + 0.2])
                here = points[-1] + step
                if np.hypot(*(here - middle)) > reach + 15:
                    angle += np.pi
                points.append(here)
            steps -= length
            line = np.round(np.array(points) * 16).astype(np.int32)
            thick = 2 if rng.random() < 0.6 else 3
            cv2.polylines(frame, [line], False, tone.tolist(), thick, cv2.LINE_AA, 4)
            cv2.polylines(drawn, [line], False, 255, thick, cv2.LINE_8, 4)
        return frame, mask | (drawn > 0)

    def _blob(self, number, frame, mask, draws):
        own = self._object(self.onset)
        edge = np.argwhere(own & ~(cv2.erode(own.astype(np.uint8), np.ones((3, 3))) > 0))
        row, column = edge[int(draws[0] * len(edge))]
        radius = self.size_px * min(1.0, 0.5 + 0.25 * (number - self.onset))
        lump = np.zeros(mask.shape, np.uint8)
        cv2.ellipse(lump, (int(column), int(row)), (max(int(radius), 2), max(int(radius * 0.8), 2)), 0, 0, 360, 255, -1)
        tone = np.median(self.base.frames[number][own], axis=0)
        depth = cv2.distanceTransform(lump, cv2.DIST_L2, 5)[..., None] / max(radius, 1)
        return np.where(lump[..., None] > 0, tone * (0.65 + 0.4 * depth), frame), mask | (lump > 0)

    def _one_missing(self, number, frame, mask, draws):
        """Nothing of it has stuck: the bed shows, and what the nozzle drags along is elsewhere."""
        frame, mask = frame.copy(), mask & ~self._region
        frame[self._region] = self.base.reference[self._region]
        return frame, mask

    _nothing = _one_missing

    def _dragged(self, number, frame, mask, draws):
        """Lines that came off at once and are dragged over the place."""
        bare_frame, bare_mask = self._one_missing(number, frame, mask, draws)
        return self._strands(number, bare_frame, bare_mask, draws, 0.7)

    # nuisances ------------------------------------------------------------------------------------------------------

    def _since(self, number):
        return number - self.from_layer

    def _dim(self, number, frame, draws):
        gain = 0.4 + 0.4 * draws[0] if self._since(number) >= 0 else 1.0
        return np.clip(frame * gain, 0, 255).astype(np.uint8), True

    def _uneven(self, number, frame, draws):
        if self._since(number) < 0:
            return frame, True
        y, x = np.mgrid[-1 : 1 : frame.shape[0] * 1j, -1 : 1 : frame.shape[1] * 1j]
        slope = np.cos(6.28 * draws[0]) * x + np.sin(6.28 * draws[0]) * y
        return np.clip(frame * (0.8 + 0.25 * draws[1] * slope)[..., None], 0, 255).astype(np.uint8), True

    def _white_balance(self, number, frame, draws):
        drift = 0.2 * (draws[:2] - 0.5) * 2 * min(1.0, max(0, self._since(number)) / 10)
        return np.clip(frame * [1 + drift[0], 1.0, 1 + drift[1]], 0, 255).astype(np.uint8), True

    def _gamma(self, number, frame, draws):
        if self._since(number) < 0:
            return frame, True
        return (255 * (frame / 255.0) ** (0.75 + 0.5 * draws[0])).astype(np.uint8), True

    def _turned(self, frame, draws, reach_px):
        K = self.base.camera.K
        tilt = reach_px / K[0, 0]
        rvec = np.array([np.sin(6.28 * draws[1]) * tilt, np.cos(6.28 * draws[1]) * tilt, (draws[2] - 0.5) * 0.5 * tilt])
        matrix = K @ cv2.Rodrigues(rvec)[0] @ np.linalg.inv(K)
        return cv2.warpPerspective(frame, matrix, frame.shape[1::-1], borderMode=cv2.BORDER_REPLICATE)

    def _nudge(self, number, frame, draws):
        return (self._turned(frame, draws, 1 + 6 * draws[0]) if self._since(number) >= 0 else frame), True

    def _knock(self, number, frame, draws):
        if self._since(number) < 0:
            return frame, True
        return self._turned(frame, draws, 10 + 20 * draws[0]), self._since(number) > 2

    def _hand(self, number, frame, draws):
        if not 0 <= self._since(number) < 1 + 3 * draws[0]:
            return frame, True
        frame, (height, width) = frame.copy(), frame.shape[:2]
        wrist = np.array([width * (0.3 + 0.7 * draws[1]), height * 1.05])
        palm = np.array([width * (0.3 + 0.4 * draws[2]), height * (0.35 + 0.4 * draws[3])])
        shape = np.zeros((height, width), np.uint8)
        cv2.line(shape, tuple(np.int32(wrist)), tuple(np.int32(palm)), 255, 85)
        for finger in range(4):
            tip = palm + np.array([-45 + 30 * finger, -75])
            cv2.line(shape, tuple(np.int32(palm + [-45 + 30 * finger, 0])), tuple(np.int32(tip)), 255, 24)
        soft = cv2.GaussianBlur(shape, (0, 0), 1.5).astype(float)[..., None] / 255
        return (frame + soft * (np.array([110.0, 140, 195]) * (0.5 + 0.5 * draws[4]) - frame)).astype(np.uint8), False

    def _head(self, number, frame, draws):
        if not 0 <= self._since(number) < 2:
            return frame, True
        frame, (height, width) = frame.copy(), frame.shape[:2]
        x, y = int(width * (0.3 + 0.4 * draws[0])), int(height * (0.2 + 0.25 * draws[1]))
        cv2.rectangle(frame, (x - 55, y - 80), (x + 55, y + 60), (35, 35, 38), -1)
        cv2.rectangle(frame, (0, y - 70), (width, y - 35), (55, 52, 50), -1)
        return frame, False

    def _alike(self, number, frame, draws):
        """Something of the filament's colour comes to stand at the picture's edge."""
        if self._since(number) < 0:
            return frame, True
        colour = np.median(self.base.frames[number][self.base.masks[number]], axis=0) * (0.8 + 0.3 * draws[0])
        frame, x = frame.copy(), int(draws[1] * frame.shape[1])
        cv2.rectangle(frame, (x - 30, 0), (x + 30, 25 + int(30 * draws[2])), np.clip(colour, 0, 255).tolist(), -1)
        return frame, True

    def _jpeg(self, number, frame, draws):
        quality = int(45 + 40 * draws[0])
        return cv2.imdecode(cv2.imencode(".jpg", frame, [cv2.IMWRITE_JPEG_QUALITY, quality])[1], cv2.IMREAD_COLOR), True

    def _hairs(self, number, frame, draws):
        """Stringing: hairs thinner than a pixel between high parts, more with every layer."""
        if self._since(number) < 0:
            return frame, True
        rng = np.random.default_rng([self.seed, 6])
        mask = self.base.masks[number]
        spots = np.argwhere(mask)
        colour, hairs = np.median(self.base.frames[number][mask], axis=0), np.zeros(mask.shape, np.uint8)
        for _ in range(min(2 + self._since(number) // 3, 12)):
            start = spots[rng.integers(len(spots))][::-1]
            end = start + rng.normal(0, 18, 2)
            cv2.line(hairs, tuple(int(v) for v in start), tuple(np.int32(end)), 110, 1, cv2.LINE_AA)
        share = hairs[..., None] / 255.0
        return (frame * (1 - share) + share * colour).astype(np.uint8), True

    def _black(self, number, frame, draws):
        bad = 0 <= self._since(number) < 2
        return (np.full_like(frame, 3) if bad else frame), not bad

    def _frozen(self, number, frame, draws):
        return (self.base.frames[number - 1], False) if self._since(number) == 1 else (frame, True)
