"""Names of disturbances before there were fewer with parameters: studies and records still have
them, and an error names the new spelling."""

from rcmservo.sim.disturbances.parameters import as_number

OLD = {
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
"""The new spelling of each, with what differs from the defaults of the new kind."""

AMOUNTS = {"camera_pan": "px", "camera_roll": "deg", "camera_dolly": "mm"}
"""The amount of a slow motion of the camera, which replaces its `speed`."""


def renewed(text: str) -> str:
    """Return a disturbance that is written with an old name in the new spelling, any other as it
    is."""
    name, _, given = text.partition(":")
    if name.strip() not in OLD:
        return text
    kind, _, defaults = OLD[name.strip()].partition(":")
    values = dict(_pairs(defaults))
    for key, value in _pairs(given):
        values["jitter" if (name, key) == ("delay", "s") else key] = value
    if kind in AMOUNTS and values.keys() >= {"speed", "for"}:
        amount = as_number(values.pop("speed")) * as_number(values["for"])
        values[AMOUNTS[kind]] = f"{amount:.12g}"
    keys = sorted(values, key=lambda key: {"at": 0, "for": 1}.get(key, 2))
    return f"{kind}:{','.join(f'{key}={values[key]}' for key in keys)}".rstrip(":")


def _pairs(items: str) -> list[tuple[str, str]]:
    """Split ``key=value,key=value``."""
    pairs = (item.partition("=") for item in items.split(",") if item)
    return [(key.strip(), value.strip()) for key, _, value in pairs]
