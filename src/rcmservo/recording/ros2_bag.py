"""Metadata that make the folder of a record a ROS 2 bag, for `ros2 bag info` and rosbags.

    with rosbags.highlevel.AnyReader([folder]) as bag:
        for connection, time, raw in bag.messages(): ...

Foxglove, Rerun and PlotJuggler open the record itself.
"""

import json
from collections.abc import Mapping
from pathlib import Path

from rcmservo.config.atomic_files import write_atomically
from rcmservo.recording.ros2_messages import TOPICS

METADATA_VERSION = 5
"""Oldest metadata version that supports MCAP; ROS 2 reads it since Humble."""

METADATA = "metadata.yaml"
"""File name of the metadata, in the folder of the record."""


def write_metadata(record: Path, counts: Mapping[str, int], duration: int) -> None:
    """Write metadata.yaml next to a record.

    JSON is valid YAML, so no YAML writer is needed.

    Parameters
    ----------
    record : Path
        File of the record.
    counts : Mapping of str to int
        Number of messages by topic.
    duration : int
        Duration in ns.
    """
    times_and_count = {
        "starting_time": {"nanoseconds_since_epoch": 0},
        "duration": {"nanoseconds": duration},
        "message_count": sum(counts.values()),
    }
    information = {
        "version": METADATA_VERSION,
        "storage_identifier": "mcap",
        "relative_file_paths": [record.name],
        **times_and_count,
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
        "files": [{"path": record.name, **times_and_count}],
    }
    text = json.dumps({"rosbag2_bagfile_information": information}, indent=1)
    write_atomically(record.with_name(METADATA), text + "\n")
