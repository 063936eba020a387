"""The file that makes the folder of a record a ROS 2 bag: `ros2 bag info` and rosbags open it as it
stands.

    with rosbags.highlevel.AnyReader([folder]) as bag:
        for connection, time, raw in bag.messages(): ...

Foxglove, Rerun and PlotJuggler open the record itself.
"""

import json
from collections.abc import Mapping
from pathlib import Path

from rcmservo.config.files import write_whole
from rcmservo.record.ros2_messages import TOPICS

VERSION = 5
"""The oldest metadata that knows MCAP files: every ROS 2 since Humble reads it."""


METADATA = "metadata.yaml"
"""Its name, beside the record."""


def write_metadata(record: Path, counts: Mapping[str, int], duration: int) -> None:
    """Write metadata.yaml beside a record of so many messages by topic over `duration` ns.

    JSON is YAML, so that no YAML writer is needed.
    """
    total = sum(counts.values())
    times = {
        "starting_time": {"nanoseconds_since_epoch": 0},
        "duration": {"nanoseconds": duration},
        "message_count": total,
    }
    information = {
        "version": VERSION,
        "storage_identifier": "mcap",
        "relative_file_paths": [record.name],
        **times,
        "topics_with_message_count": [
            {
                "topic_metadata": {
                    "name": topic,
                    "type": TOPICS[topic],
                    "serialization_format": "cdr",
                    "offered_qos_profiles": "",
                },
                "message_count": count,
            }
            for topic, count in counts.items()
        ],
        "compression_format": "",
        "compression_mode": "",
        "files": [{"path": record.name, **times}],
    }
    text = json.dumps({"rosbag2_bagfile_information": information}, indent=1)
    write_whole(record.with_name(METADATA), text + "\n")
