"""Former names of disturbances, which old studies and records contain.

They are read from such files. A user who types one gets an error with the present spelling.
"""

from rcmservo.sim.disturbances.parameters import to_number

OLD_NAMES = {
    "marker_loss": "occlusion",
    "smoke": "occlusion:by=smoke",
    "stain": "occlusion:by=blood",
    "false_marker": "decoy",
    "flicker": "decoy:every=2",
    "slide": "decoy:px=0,speed=5",
    "bump": "camera_pan",
    "pan": "camera_pan:for=4.5,speed=10",
    "roll": "camera_roll",
    "rolling": "camera_roll:for=8,speed=1",
    "dolly": "camera_dolly:for=4,speed=2",
    "zoom": "camera_zoom",
    "stuck": "frame_drop:share=1",
    "delay": "latency:s=0,jitter=0.2",
    "repeat": "frame_order",
    "shuffle": "frame_order:what=swapped",
    "clock_step": "camera_clock:s=3600",
    "clocks_apart": "camera_clock:of=exposures",
    "axis_stuck": "gain:factor=0",
    "axis_reversed": "gain:factor=-1",
    "encoder_reversed": "encoder",
    "encoder_zero": "encoder:factor=1,offset=5",
    "overrun": "stall:for=0.1,where=tick",
    "hang": "stall",
}
"""Present spelling by former name. It contains the values that differ from the kind's defaults."""

MOTION_AMOUNTS = {"camera_pan": "px", "camera_roll": "deg", "camera_dolly": "mm"}
"""Parameter with the amount of a slow camera motion; the former parameter was its `speed`."""


def translate_old_name(text: str) -> str:
    """Return a disturbance's text in its present spelling, unchanged unless its name is old."""
    name, _, given_items = text.partition(":")
    if name.strip() not in OLD_NAMES:
        return text
    kind, _, default_items = OLD_NAMES[name.strip()].partition(":")
    values = dict(_split_pairs(default_items))
    for key, value in _split_pairs(given_items):
        values["jitter" if (name, key) == ("delay", "s") else key] = value
    if kind in MOTION_AMOUNTS and values.keys() >= {"speed", "for"}:
        amount = to_number(values.pop("speed")) * to_number(values["for"])
        values[MOTION_AMOUNTS[kind]] = f"{amount:.12g}"
    keys = sorted(values, key=lambda key: {"at": 0, "for": 1}.get(key, 2))
    return f"{kind}:{','.join(f'{key}={values[key]}' for key in keys)}".rstrip(":")


def _split_pairs(items: str) -> list[tuple[str, str]]:
    """Split ``key=value,key=value``."""
    pairs = (item.partition("=") for item in items.split(",") if item)
    return [(key.strip(), value.strip()) for key, _, value in pairs]
