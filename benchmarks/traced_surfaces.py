"""What the path-traced scenes are made of: filaments, beds, and what a printer looks like.

Imports Mitsuba, and chooses its variant for all of these modules.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import mitsuba as mi
import numpy as np

mi.set_variant("llvm_ad_rgb")

FILAMENTS = {
    "black": ((26, 26, 28), "plain"), "anthracite": ((62, 64, 68), "plain"), "grey": ((128, 130, 131), "plain"),
    "white": ((232, 232, 226), "plain"), "natural": ((214, 208, 188), "clear"), "clear blue": ((120, 170, 214), "clear"),
    "silk gold": ((204, 150, 52), "silk"), "silk silver": ((178, 180, 184), "silk"), "silk purple": ((110, 52, 150), "silk"),
    "red": ((196, 30, 28), "plain"), "orange": ((236, 106, 18), "plain"), "yellow": ((232, 194, 22), "plain"),
    "green": ((38, 142, 62), "plain"), "teal": ((22, 128, 132), "plain"), "blue": ((24, 62, 168), "plain"),
    "wood": ((150, 106, 66), "plain"), "pink": ((226, 112, 150), "plain"),
}  # fmt: skip
BEDS = ("glass", "pei", "textured pei", "gold pei", "blue tape", "metal", "sticker")
LIGHTS = ("ring", "hard lamp", "led strip", "window", "dim", "ceiling", "enclosure")


@dataclass(frozen=True)
class Look:
    """Everything one sees besides the print. Lengths in mm, colours sRGB 0 to 255."""

    filament: str
    bed: str
    light: str
    motion: str
    volume_mm: tuple[float, float, float]
    centre_origin: bool
    reference_mm: tuple[float, float, float]
    seed: int
    delta: bool = False

    @property
    def low_mm(self) -> np.ndarray:
        return np.array([-self.volume_mm[0] / 2, -self.volume_mm[1] / 2]) if self.centre_origin else np.zeros(2)

    def shift_mm(self, position_mm: tuple[float, float, float]) -> np.ndarray:
        """What the bed, and the print with it, has moved from its reference."""
        gone = np.subtract(self.reference_mm, position_mm)
        return gone * {"fixed": (0, 0, 0), "y": (0, 1, 0), "z": (0, 0, 1)}[self.motion]


def linear(rgb: tuple) -> list[float]:
    return [float(((c / 255 + 0.055) / 1.055) ** 2.4 if c > 10 else c / 255 / 12.92) for c in rgb]


def grain(rng: np.random.Generator, size: int, *scales: float) -> np.ndarray:
    """(size, size) noise about 0 with deviation 1, coarse to fine."""
    out = np.zeros((size, size), np.float32)
    for scale in scales:
        few = max(2, int(size / scale))
        one = cv2.resize(rng.normal(0, 1, (few, few)).astype(np.float32), (size, size), interpolation=cv2.INTER_CUBIC)
        out += one / (one.std() + 1e-6)
    return out / np.sqrt(len(scales))


def scratched(rng: np.random.Generator, picture: np.ndarray, count: int, strength: float) -> np.ndarray:
    layer = np.zeros(picture.shape[:2], np.float32)
    for _ in range(count):
        a = rng.integers(0, picture.shape[0], 2)
        b = a + rng.normal(0, 120, 2).astype(int)
        cv2.line(layer, tuple(map(int, a)), tuple(map(int, b)), float(rng.random()), 1, cv2.LINE_AA)
    for _ in range(count // 8):  # where earlier prints stood
        a, s = rng.integers(100, picture.shape[0] - 300, 2), rng.integers(60, 260, 2)
        cv2.rectangle(layer, tuple(map(int, a)), tuple(map(int, a + s)), float(rng.random() * 0.6), 2, cv2.LINE_AA)
    return np.clip(picture * (1 + strength * layer[..., None]), 0.002, 0.95)


def bed_surface(look: Look, rng: np.random.Generator) -> dict:
    """A BSDF with its picture."""
    size = 1024
    base = np.ones((size, size, 3), np.float32)
    fine, coarse = grain(rng, size, 2), grain(rng, size, 60, 200)
    if look.bed == "glass":
        tone = [(18, 19, 21), (58, 60, 62), (150, 78, 40), (196, 198, 200)][rng.integers(4)]
        picture = base * linear(tone) * (1 + 0.06 * coarse[..., None] + 0.02 * fine[..., None])
        smear = np.clip(grain(rng, size, 120, 30, 6) - 1.4, 0, 1)[..., None] * 0.03 * rng.random()
        return {
            "type": "plastic",
            "int_ior": 1.52,
            "diffuse_reflectance": bitmap(scratched(rng, picture, 40, 0.15) + smear),
        }
    if look.bed == "pei":
        picture = (
            base * linear([(196, 128, 38), (24, 24, 26), (44, 42, 40)][rng.integers(3)]) * (1 + 0.1 * coarse[..., None])
        )
        return coated(scratched(rng, picture, 160, 0.25), 0.08 + 0.15 * rng.random())
    if look.bed in ("textured pei", "gold pei"):
        tone = (26, 26, 28) if look.bed == "textured pei" else (176, 128, 56)
        speck = np.clip(fine + 0.6 * grain(rng, size, 3), -2, 3)[..., None]
        return coated(scratched(rng, base * linear(tone) * (1 + 0.28 * speck + 0.06 * coarse[..., None]), 50, 0.3), 0.3)
    if look.bed == "blue tape":
        x = np.arange(size)
        pitch = size * 25.0 / look.volume_mm[0]
        strip = ((x + rng.integers(40)) // pitch).astype(int)
        tone = 1 + 0.10 * rng.normal(0, 1, strip.max() + 2)[strip]
        seam = 1 - 0.55 * (((x + 11) % pitch) < 2)
        picture = base * linear((62, 122, 178)) * (tone * seam)[None, :, None]
        picture = picture * (1 + 0.10 * np.clip(grain(rng, size, 4, 9), -2, 2)[..., None])
        tear = (grain(rng, size, 40) > 2.4)[..., None]
        return coated(np.where(tear, linear((120, 150, 178)), scratched(rng, picture, 80, 0.4)), 0.4)
    if look.bed == "metal":
        streak = cv2.GaussianBlur(rng.normal(0, 1, (size, size)).astype(np.float32), (0, 0), sigmaX=60, sigmaY=0.6)
        picture = base * (0.50 + 0.10 * streak[..., None] / streak.std())
        metal = {"type": "principled", "metallic": 0.7, "roughness": 0.42, "anisotropic": 0.7, "specular": 0.5}
        metal["base_color"] = bitmap(scratched(rng, np.clip(picture, 0.1, 0.9), 120, 0.3))
        return {"type": "twosided", "bsdf": metal}
    picture = (
        base * linear([(205, 205, 200), (38, 38, 40), (120, 122, 126)][rng.integers(3)]) * (1 + 0.05 * fine[..., None])
    )
    ink = [float(c) for c in linear([(230, 230, 230), (30, 30, 32), (222, 110, 30)][rng.integers(3)])]
    ink = ink if abs(ink[1] - float(picture.mean())) > 0.05 else [0.5, 0.5, 0.5]
    for n in range(1, 10):
        at = int(size * n / 10)
        cv2.line(picture, (at, 40), (at, size - 40), ink, 1 + (n == 5), cv2.LINE_AA)
        cv2.line(picture, (40, at), (size - 40, at), ink, 1 + (n == 5), cv2.LINE_AA)
    words = np.zeros((size, size), np.uint8)
    cv2.putText(words, "PRINT ON", (size // 3, 930), cv2.FONT_HERSHEY_DUPLEX, 2.4, 255, 6, cv2.LINE_AA)
    picture = np.where(words[..., None] > 127, np.float32(ink), picture)
    return coated(scratched(rng, picture, 90, 0.25), 0.3)


def bitmap(picture: np.ndarray) -> dict:
    clean = np.clip(picture, 0.002, 0.95).astype(np.float32)
    return {"type": "bitmap", "bitmap": mi.Bitmap(np.ascontiguousarray(clean[::-1])), "raw": True}


def coated(picture: np.ndarray, alpha: float) -> dict:
    return {
        "type": "roughplastic",
        "distribution": "ggx",
        "alpha": float(alpha),
        "diffuse_reflectance": bitmap(picture),
    }


def matt(rgb: tuple) -> dict:
    return {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": linear(rgb)}}}


def filament_surface(name: str) -> dict:
    rgb, kind = FILAMENTS[name]
    colour = {"type": "rgb", "value": linear(rgb)}
    if kind == "silk":
        return {"type": "principled", "base_color": colour, "metallic": 0.75, "roughness": 0.32, "specular": 0.6}
    plastic = {
        "type": "roughplastic",
        "distribution": "ggx",
        "alpha": 0.16,
        "nonlinear": True,
        "diffuse_reflectance": colour,
    }
    if kind == "clear":
        return {"type": "mask", "opacity": 0.55, "bsdf": {"type": "twosided", "bsdf": plastic}}
    return {"type": "twosided", "bsdf": plastic}
