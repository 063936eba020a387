"""Binding of the Aravis library through ctypes. It needs only Debian's package of the library.

Written for Aravis 0.8.26. A function that fails raises :class:`AravisError` with the
library's text.
"""

import ctypes
import functools
from collections.abc import Callable
from ctypes import POINTER, byref, c_bool, c_char_p, c_double, c_int, c_size_t, c_uint, c_void_p
from typing import Any

from rcmservo.errors import RcmServoError, shorten_to_line

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

INT, LONG, TEXT, ADDRESS, REAL = c_int, ctypes.c_uint64, c_char_p, c_void_p, c_double

Signature = tuple[Any, tuple[Any, ...]]
"""Type of the result and types of the arguments of a function."""


def _declare(names: str, result: Any, *arguments: Any) -> dict[str, Signature]:
    """Return the signature of each function in a text of names."""
    return dict.fromkeys(names.split(), (result, arguments))


CAN_FAIL = {
    **_declare("camera_new", ADDRESS, TEXT),
    **_declare("camera_create_stream", ADDRESS, ADDRESS, ADDRESS, ADDRESS),
    **_declare("camera_start_acquisition camera_stop_acquisition", None, ADDRESS),
    **_declare("camera_clear_triggers", None, ADDRESS),
    **_declare("camera_set_acquisition_mode camera_gv_set_packet_size", None, ADDRESS, INT),
    **_declare("camera_set_exposure_time_auto camera_set_gain_auto", None, ADDRESS, INT),
    **_declare("camera_set_pixel_format", None, ADDRESS, ctypes.c_uint32),
    **_declare("camera_set_region", None, ADDRESS, INT, INT, INT, INT),
    **_declare("camera_get_region", None, ADDRESS, *[POINTER(INT)] * 4),
    **_declare("camera_set_frame_rate camera_set_exposure_time", None, ADDRESS, REAL),
    **_declare("camera_set_gain", None, ADDRESS, REAL),
    **_declare("camera_get_frame_rate camera_get_exposure_time camera_get_gain", REAL, ADDRESS),
    **_declare("camera_is_exposure_auto_available", c_bool, ADDRESS),
    **_declare("camera_is_gain_auto_available", c_bool, ADDRESS),
    **_declare("camera_get_payload camera_gv_get_packet_size", c_uint, ADDRESS),
}
"""Functions with an error argument: types of the result and of the arguments before it."""

CANNOT_FAIL = {
    **_declare("camera_set_range_check_policy", None, ADDRESS, INT),
    **_declare("camera_is_gv_device gv_fake_camera_is_running", c_bool, ADDRESS),
    **_declare("stream_push_buffer", None, ADDRESS, ADDRESS),
    **_declare("stream_timeout_pop_buffer", ADDRESS, ADDRESS, LONG),
    **_declare("stream_try_pop_buffer gv_fake_camera_get_fake_camera", ADDRESS, ADDRESS),
    **_declare("buffer_new_allocate", ADDRESS, c_size_t),
    **_declare("buffer_get_frame_id buffer_get_timestamp", LONG, ADDRESS),
    **_declare("buffer_set_timestamp", None, ADDRESS, LONG),
    **_declare("buffer_get_status buffer_get_image_width buffer_get_image_height", INT, ADDRESS),
    **_declare("buffer_get_image_pixel_format", ctypes.c_uint32, ADDRESS),
    **_declare("buffer_get_data", ADDRESS, ADDRESS, POINTER(c_size_t)),
    **_declare("gv_fake_camera_new", ADDRESS, TEXT, TEXT),
    **_declare("fake_camera_set_fill_pattern", None, ADDRESS, ADDRESS, ADDRESS),
    **_declare("fake_camera_write_register", c_bool, ADDRESS, ctypes.c_uint32, ctypes.c_uint32),
}
"""Functions without an error argument: types of the result and the arguments."""

FILL_CALLBACK = ctypes.CFUNCTYPE(None, c_void_p, c_void_p, ctypes.c_uint32, ctypes.c_uint32, c_uint)
"""Type of the callback that fills a fake camera's buffer. Arguments: buffer, user data, exposure in
µs, gain, pixel format."""


class AravisError(RcmServoError):
    """Error that the library reports, with its text."""


class _GError(ctypes.Structure):
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
            self._gobject, self._glib = load("libgobject-2.0.so.0"), load("libglib-2.0.so.0")
        except OSError as error:
            raise AravisError(NOT_INSTALLED) from error
        for table, error_type in ((CAN_FAIL, (c_void_p,)), (CANNOT_FAIL, ())):
            for name, (result, arguments) in table.items():
                function = getattr(self._aravis, f"arv_{name}")
                function.restype, function.argtypes = result, (*arguments, *error_type)
        self._gobject.g_object_unref.argtypes = (c_void_p,)
        self._glib.g_error_free.argtypes = (c_void_p,)

    def call(self, name: str, *arguments: Any) -> Any:
        """Call a function of the library."""
        function = getattr(self._aravis, f"arv_{name}")
        if name not in CAN_FAIL:
            return function(*arguments)
        error = POINTER(_GError)()
        result = function(*arguments, byref(error))
        if error:
            text = shorten_to_line((error.contents.message or b"").decode(errors="replace"))
            self._glib.g_error_free(error)
            raise AravisError(text)
        return result

    def find_data(self, buffer: int) -> tuple[int, int]:
        """Return address and size (bytes) of a buffer's content."""
        size = c_size_t()
        return self.call("buffer_get_data", buffer, byref(size)) or 0, size.value

    def release(self, instance: int) -> None:
        """Release an object of the library."""
        self._gobject.g_object_unref(instance)


@functools.cache
def load_aravis() -> Aravis:
    """Return the library, loaded once per process."""
    return Aravis()
