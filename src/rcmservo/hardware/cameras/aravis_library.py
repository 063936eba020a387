"""Binding of the Aravis library through ctypes, for any Python with Debian's package alone.

Written for Aravis 0.8.26. A function that fails raises :class:`AravisError` with the
library's text.
"""

import ctypes
import functools
from collections.abc import Callable
from ctypes import POINTER, byref, c_bool, c_char_p, c_double, c_int, c_size_t, c_uint, c_void_p
from typing import Any

from rcmservo.errors import RcmServoError, one_line

LIBRARY = "libaravis-0.8.so.0"
NOT_INSTALLED = (
    "cameras of the kind aravis need the Aravis library, and it is not installed: "
    "sudo apt-get install libaravis-0.8-0"
)

ACQUISITION_CONTINUOUS = 0
"""Acquisition mode."""
AUTO_OFF = 0
"""Automatic exposure or gain switched off."""
RANGE_CHECK_ENABLED = 1
"""Range check of settings against the camera's bounds."""
BUFFER_COMPLETE = 0
"""Status of a buffer with a complete frame."""

INT, LONG, TEXT, POINTER_, REAL = c_int, ctypes.c_uint64, c_char_p, c_void_p, c_double

CAN_FAIL: dict[str, tuple[Any, tuple[Any, ...]]] = {
    "camera_new": (POINTER_, (TEXT,)),
    "camera_create_stream": (POINTER_, (POINTER_, POINTER_, POINTER_)),
    "camera_start_acquisition": (None, (POINTER_,)),
    "camera_stop_acquisition": (None, (POINTER_,)),
    "camera_set_acquisition_mode": (None, (POINTER_, INT)),
    "camera_set_pixel_format": (None, (POINTER_, ctypes.c_uint32)),
    "camera_set_region": (None, (POINTER_, INT, INT, INT, INT)),
    "camera_get_region": (None, (POINTER_, *[POINTER(INT)] * 4)),
    "camera_clear_triggers": (None, (POINTER_,)),
    "camera_set_frame_rate": (None, (POINTER_, REAL)),
    "camera_get_frame_rate": (REAL, (POINTER_,)),
    "camera_is_exposure_auto_available": (c_bool, (POINTER_,)),
    "camera_set_exposure_time_auto": (None, (POINTER_, INT)),
    "camera_set_exposure_time": (None, (POINTER_, REAL)),
    "camera_get_exposure_time": (REAL, (POINTER_,)),
    "camera_is_gain_auto_available": (c_bool, (POINTER_,)),
    "camera_set_gain_auto": (None, (POINTER_, INT)),
    "camera_set_gain": (None, (POINTER_, REAL)),
    "camera_get_gain": (REAL, (POINTER_,)),
    "camera_get_payload": (c_uint, (POINTER_,)),
    "camera_gv_set_packet_size": (None, (POINTER_, INT)),
    "camera_gv_get_packet_size": (c_uint, (POINTER_,)),
}
"""Functions with an error argument: types of the result and of the arguments before it."""

CANNOT_FAIL: dict[str, tuple[Any, tuple[Any, ...]]] = {
    "camera_set_range_check_policy": (None, (POINTER_, INT)),
    "camera_is_gv_device": (c_bool, (POINTER_,)),
    "stream_push_buffer": (None, (POINTER_, POINTER_)),
    "stream_timeout_pop_buffer": (POINTER_, (POINTER_, LONG)),
    "stream_try_pop_buffer": (POINTER_, (POINTER_,)),
    "buffer_new_allocate": (POINTER_, (c_size_t,)),
    "buffer_get_status": (INT, (POINTER_,)),
    "buffer_get_frame_id": (LONG, (POINTER_,)),
    "buffer_get_timestamp": (LONG, (POINTER_,)),
    "buffer_set_timestamp": (None, (POINTER_, LONG)),
    "buffer_get_image_width": (INT, (POINTER_,)),
    "buffer_get_image_height": (INT, (POINTER_,)),
    "buffer_get_image_pixel_format": (ctypes.c_uint32, (POINTER_,)),
    "buffer_get_data": (POINTER_, (POINTER_, POINTER(c_size_t))),
    "gv_fake_camera_new": (POINTER_, (TEXT, TEXT)),
    "gv_fake_camera_is_running": (c_bool, (POINTER_,)),
    "gv_fake_camera_get_fake_camera": (POINTER_, (POINTER_,)),
    "fake_camera_set_fill_pattern": (None, (POINTER_, POINTER_, POINTER_)),
    "fake_camera_write_register": (c_bool, (POINTER_, ctypes.c_uint32, ctypes.c_uint32)),
}
"""Functions without an error argument: types of the result and the arguments."""

FILL_CALLBACK = ctypes.CFUNCTYPE(None, c_void_p, c_void_p, ctypes.c_uint32, ctypes.c_uint32, c_uint)
"""Type of the callback that fills a fake camera's buffer. Arguments: buffer, user data, exposure in
µs, gain, pixel format."""


class AravisError(RcmServoError):
    """Error that the library reports, with its text."""


class _Error(ctypes.Structure):
    _fields_ = [("domain", ctypes.c_uint32), ("code", c_int), ("message", c_char_p)]


class Aravis:
    """Loaded library. `call` calls its functions by their names without `arv_`.

    Parameters
    ----------
    load : callable
        Loader of a shared library by name.

    Raises
    ------
    AravisError
        If the library is not installed.
    """

    def __init__(self, load: Callable[[str], Any] = ctypes.CDLL) -> None:
        try:
            self._aravis = load(LIBRARY)
            self._objects, self._base = load("libgobject-2.0.so.0"), load("libglib-2.0.so.0")
        except OSError as error:
            raise AravisError(NOT_INSTALLED) from error
        for table, error_type in ((CAN_FAIL, (c_void_p,)), (CANNOT_FAIL, ())):
            for name, (result, arguments) in table.items():
                function = getattr(self._aravis, f"arv_{name}")
                function.restype, function.argtypes = result, (*arguments, *error_type)
        self._objects.g_object_unref.argtypes = (c_void_p,)
        self._base.g_error_free.argtypes = (c_void_p,)

    def call(self, name: str, *arguments: Any) -> Any:
        """Call a function of the library."""
        function = getattr(self._aravis, f"arv_{name}")
        if name not in CAN_FAIL:
            return function(*arguments)
        error = POINTER(_Error)()
        result = function(*arguments, byref(error))
        if error:
            text = one_line((error.contents.message or b"").decode(errors="replace"))
            self._base.g_error_free(error)
            raise AravisError(text)
        return result

    def data(self, buffer: int) -> tuple[int, int]:
        """Return address and size (bytes) of a buffer's content."""
        size = c_size_t()
        return self.call("buffer_get_data", buffer, byref(size)) or 0, size.value

    def release(self, instance: int) -> None:
        """Release an object of the library."""
        self._objects.g_object_unref(instance)


@functools.cache
def load_aravis() -> Aravis:
    """Return the library, loaded once per process."""
    return Aravis()
