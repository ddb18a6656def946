"""Draws beads with OpenGL 3.1 into integer images, without a window. The only module that knows moderngl.

The context belongs to the thread that made it: elsewhere reads return zeros without an error, and an expected mask of
zeros would be a false pause. So another thread is refused, the target is filled with a value that no draw writes and
zeros read back are an error, and a known bead is drawn once for each context.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import moderngl
import numpy as np

from ..core.camera import Camera
from ..core.errors import RenderError
from ..core.expected.beads import DRAWN_BEAD, drawn_beads, straight_mm
from ..core.expected.lens import outermost_ray, shown, tilt
from ..core.expected.solid import Solid
from ..core.toolpath import Toolpath

CHUNK = 1 << 14  # instances a draw call: bounds graphics memory and the time for which moderngl holds the GIL
UNTOUCHED = np.uint32(0xFFFFFFFF)  # no draw writes it, and no failed read returns it

# Camera models as OpenCV documents them (calib3d, "Detailed description"; fisheye: Kannala and Brandt 2006).
PROJECT = """
#version 140
uniform mat3 camera_from_print;
uniform vec3 print_origin_camera;
uniform mat3 ndc_from_lens;
uniform float k[12];
uniform bool fisheye;
uniform float outermost;

bool shows(vec3 p) {
    vec3 c = camera_from_print * p + print_origin_camera;
    return c.z > 1.0 && length(c.xy) < outermost * c.z;
}

vec2 to_ndc(vec3 c) {
    vec2 u = c.xy / c.z, d;
    float r2 = dot(u, u);
    if (fisheye) {
        float r = sqrt(r2), t = atan(r), t2 = t * t;
        float bent = t * (1.0 + t2 * (k[0] + t2 * (k[1] + t2 * (k[2] + t2 * k[3]))));
        d = r > 1e-6 ? u * (bent / r) : u;
    } else {
        float radial = (1.0 + r2 * (k[0] + r2 * (k[1] + r2 * k[4]))) / (1.0 + r2 * (k[5] + r2 * (k[6] + r2 * k[7])));
        d = u * radial + vec2(
            2.0 * k[2] * u.x * u.y + k[3] * (r2 + 2.0 * u.x * u.x) + r2 * (k[8] + r2 * k[9]),
            k[2] * (r2 + 2.0 * u.y * u.y) + 2.0 * k[3] * u.x * u.y + r2 * (k[10] + r2 * k[11]));
    }
    vec3 n = ndc_from_lens * vec3(d, 1.0);
    return n.xy / n.z;
}
"""

# A bead is a line swept by the ellipsoid of its width and height, so its outline is that of two ellipses: six points of
# it, the tips and both flanks at either end, are where the ellipsoid's normal is at right angles to the view.
# Constant depth with the test LESS keeps what was drawn first, and GL draws instances in order.
BEADS = (
    PROJECT
    + """
uniform vec3 eye_print;
in vec3 start;
in vec3 end;
in vec2 size;
in uint birth;
flat out uint pixel;

// strip order: along the bead, across it
const vec2 OUTLINE[6] = vec2[6](vec2(1, 0), vec2(1, 1), vec2(1, -1), vec2(-1, 1), vec2(-1, -1), vec2(-1, 0));

void main() {
    pixel = birth;
    vec3 run = end - start;
    vec3 view = normalize(eye_print - 0.5 * (start + end));
    vec3 along = run - view * dot(run, view);
    float length_seen = length(along);
    along = length_seen > 1e-5 ? along / length_seen : normalize(cross(view, vec3(0.6, 0.64, 0.48)));
    vec3 across = cross(view, along);
    vec2 outline = OUTLINE[gl_VertexID];
    vec3 normal = outline.y == 0.0 ? outline.x * along : outline.y * across;
    vec3 half_axes = 0.5 * size.xxy;
    vec3 p = (outline.x > 0.0 ? end : start) - vec3(0.0, 0.0, half_axes.z);
    p += half_axes * half_axes * normal / length(half_axes * normal);
    vec3 c = camera_from_print * p + print_origin_camera;
    bool seen = shows(start) && shows(end) && c.z > 0.5;
    gl_Position = seen ? vec4(to_ndc(c), 0.0, 1.0) : vec4(2.0, 2.0, 2.0, 1.0);
}
"""
)

BIRTH = """
#version 140
flat in uint pixel;
out uint birth;
void main() { birth = pixel; }
"""

# Of everything that the ray through a pixel meets, the lowest point tells from which height on the pixel is covered: a
# closed surface cut off above some height and drawn from both sides has the outline of the solid with a lid on. So one
# drawing with the height as depth holds the masks of all heights, and no clipping is needed.
SURFACE = (
    PROJECT
    + """
in vec3 corner;
out float height;

void main() {
    height = corner.z;
    vec3 c = camera_from_print * corner + print_origin_camera;
    gl_Position = vec4(to_ndc(c) * c.z, 0.0, c.z);
}
"""
)

HEIGHT = """
#version 140
uniform float top;
in float height;
out uint lowest;

void main() {
    float h = max(height, 0.0);
    lowest = 1u + uint(h * 1000.0 + 0.5);
    gl_FragDepth = h / top;
}
"""


class GlRenderer:
    """A MaskRenderer on OpenGL 3.1 or newer (hardware, or Mesa's llvmpipe). Use it in the thread that made it."""

    def __init__(self, device_index: int | None = None) -> None:
        """Raises RenderError where no context can be made or a known bead is not drawn as it must be."""
        create: Any = moderngl.create_context  # its types know nothing of the backends' options
        options = {} if device_index is None else {"device_index": device_index}
        try:
            # libEGL carries the GL functions too, so that libGL and with it X11's libraries are not needed.
            self._context = create(
                standalone=True, backend="egl", require=310, libgl="libEGL.so.1", libegl="libEGL.so.1", **options
            )
        except Exception as error:  # moderngl raises plain Exception
            raise RenderError(f"OpenGL does not start here ({error}).") from None
        self._owner = threading.get_ident()
        self.device = str(self._context.info["GL_RENDERER"])
        self.software = any(name in self.device.lower() for name in ("llvmpipe", "softpipe", "swrast"))
        self.version = self._context.version_code
        self.name = f"OpenGL on {self.device}"
        _ = self._context.error  # a 3.1 context reports the states that are newer than itself; that is no fault
        self._targets: dict[tuple[int, int], tuple[moderngl.Texture, moderngl.Framebuffer, moderngl.Renderbuffer]] = {}
        try:
            self._program = self._context.program(vertex_shader=BEADS, fragment_shader=BIRTH)
            self._scratch = self._context.buffer(reserve=CHUNK * DRAWN_BEAD.itemsize)
            self._beads = self._context.vertex_array(
                self._program, [(self._scratch, "3f 3f 2f 1u/i", "start", "end", "size", "birth")]
            )
            self._surface_program: Any = self._context.program(vertex_shader=SURFACE, fragment_shader=HEIGHT)
            self._surface = self._context.vertex_array(self._surface_program, [(self._scratch, "3f", "corner")])
        except moderngl.Error as error:
            self._context.release()
            raise RenderError(f"{self.name} cannot draw beads ({error}).") from None
        self._check()

    def __enter__(self) -> GlRenderer:
        return self

    def __exit__(self, *exception: object) -> None:
        self.release()

    def release(self) -> None:
        """Frees everything on the graphics side. The renderer cannot be used afterwards."""
        with self._current():
            for texture, frame, depth in self._targets.values():
                frame.release()
                depth.release()
                texture.release()
            self._targets.clear()
            self._beads.release()
            self._surface.release()
            self._scratch.release()
            self._program.release()
            self._surface_program.release()
        self._context.release()

    def birth_map(
        self,
        toolpath: Toolpath,
        camera: Camera,
        room_from_print_mm: np.ndarray,
        beads: np.ndarray | None = None,
    ) -> np.ndarray:
        """As MaskRenderer says."""
        with self._current():
            return self._births(toolpath, camera, np.asarray(room_from_print_mm, dtype=np.float64), beads)

    def _births(self, toolpath: Toolpath, camera: Camera, shift_mm: np.ndarray, beads: np.ndarray | None) -> np.ndarray:
        frame = self._begin(self._program, camera, shift_mm)
        longest_mm = straight_mm(toolpath.bounds_mm(), camera, shift_mm)
        for drawn in drawn_beads(toolpath.beads_mm, beads, longest_mm, CHUNK):
            self._scratch.orphan()
            self._scratch.write(drawn)
            self._beads.render(moderngl.TRIANGLE_STRIP, vertices=6, instances=len(drawn))
            if self.software:  # which otherwise keeps what it has not drawn yet in memory
                self._context.finish()
            toolpath.let_go()
        return self._finish(frame, camera)

    def solid_map(self, solid: Solid, camera: Camera, room_from_print_mm: np.ndarray) -> np.ndarray:
        """As MaskRenderer says."""
        with self._current():
            return self._lowest(solid, camera, np.asarray(room_from_print_mm, dtype=np.float64))

    def _lowest(self, solid: Solid, camera: Camera, shift_mm: np.ndarray) -> np.ndarray:
        frame = self._begin(self._surface_program, camera, shift_mm)
        bounds_mm = solid.bounds_mm()
        self._surface_program["top"].value = max(float(bounds_mm[1, 2]), 1e-3) * 1.001
        triangles = solid.cut(straight_mm(bounds_mm, camera, shift_mm))
        for first in range(0, len(triangles), CHUNK):
            drawn = triangles[first : first + CHUNK]
            drawn = drawn[shown(drawn.reshape(-1, 3) + shift_mm, camera).reshape(-1, 3).all(axis=1)]
            if len(drawn):
                self._scratch.orphan()
                self._scratch.write(np.ascontiguousarray(drawn))
                self._surface.render(moderngl.TRIANGLES, vertices=3 * len(drawn))
        return self._finish(frame, camera)

    def _begin(self, program: Any, camera: Camera, shift_mm: np.ndarray) -> moderngl.Framebuffer:
        width, height = camera.image_size_px
        texture, frame = self._target(camera.image_size_px)
        self._look(program, camera, shift_mm)
        frame.use()
        frame.clear(depth=1.0)
        texture.write(np.full(width * height, UNTOUCHED))  # GL does not define clearing integers by floats
        self._context.enable_only(moderngl.DEPTH_TEST)
        self._context.depth_func = "<"
        return frame

    def _finish(self, frame: moderngl.Framebuffer, camera: Camera) -> np.ndarray:
        width, height = camera.image_size_px
        pixels = np.empty((height, width), dtype=np.uint32)
        frame.read_into(pixels, components=1, alignment=1, dtype="u4")
        if not pixels.all():
            raise RenderError(f"{self.name} returned an empty picture. `moop doctor` tries it; restart the server.")
        pixels[pixels == UNTOUCHED] = 0
        return pixels

    @contextmanager
    def _current(self) -> Iterator[None]:
        """Makes this the thread's context. Raises RenderError in a thread not its owner, and for GL's errors."""
        if threading.get_ident() != self._owner:
            raise RenderError("OpenGL was called from a thread that does not own it. This is a bug; please report it.")
        with self._context:
            try:
                yield
            except moderngl.Error as error:
                raise RenderError(
                    f"{self.name} failed ({error}). `moop doctor` tries it; restart the server."
                ) from None

    def _target(self, size_px: tuple[int, int]) -> tuple[moderngl.Texture, moderngl.Framebuffer]:
        if size_px not in self._targets:
            texture = self._context.texture(size_px, 1, dtype="u4")
            depth = self._context.depth_renderbuffer(size_px)
            self._targets[size_px] = (texture, self._context.framebuffer([texture], depth), depth)
        return self._targets[size_px][:2]

    def _look(self, program: Any, camera: Camera, shift_mm: np.ndarray) -> None:
        """Hands the camera to the shader: composed in float64, rounded once."""
        width, height = camera.image_size_px
        # Pixel centres lie at whole numbers in OpenCV and at halves in GL; row 0 is drawn, and read, first.
        ndc_from_image = np.array([[2 / width, 0, 1 / width - 1], [0, 2 / height, 1 / height - 1], [0, 0, 1]])
        camera_from_room = camera.camera_from_room
        k = np.zeros(12)
        k[: min(12, camera.distortion.size)] = camera.distortion[:12]
        values = {
            "camera_from_print": camera_from_room[:3, :3].T,
            "print_origin_camera": camera_from_room[:3, :3] @ shift_mm + camera_from_room[:3, 3],
            "eye_print": camera.centre_mm - shift_mm,
            "ndc_from_lens": (ndc_from_image @ camera.K @ tilt(camera)).T,
            "k": k,
            "outermost": np.array(outermost_ray(camera)),
        }
        for name, value in values.items():
            if name in program:  # what a program does not use, the driver leaves out
                program[name].write(np.ascontiguousarray(value, dtype=np.float32))
        program["fisheye"].value = camera.model == "fisheye"

    def _check(self) -> None:
        """Draws one bead whose picture is known. Raises RenderError unless it comes out."""
        bead = np.array([[-10, 0, 100, 10, 0, 100, 10.2, 0.02]], dtype=np.float32)
        one = np.ones(1, dtype=np.int64)
        toolpath = Toolpath(bead, one, np.array([0, 1]), one, bead[:, 5], one.astype("u1"), one.astype("i2"))
        K = np.array([[100, 0, 19.5], [0, 100, 14.5], [0, 0, 1]])
        camera = Camera((40, 30), K, np.zeros(5), np.zeros(3), np.zeros(3))
        births = self.birth_map(toolpath, camera, np.zeros(3))
        wanted = np.zeros((30, 40), dtype=np.uint32)
        for row in range(10, 20):  # a hexagon: the tips are half a width beyond the ends
            tip = int(np.floor(5.6 - abs(row - 14.5)))
            wanted[row, 10 - tip : 30 + tip] = 1
        if not np.array_equal(births, wanted):
            self.release()
            raise RenderError(f"{self.name} draws a known picture wrongly. Another renderer will be used.")
