"""Recordings of other programs: folders of frames with joints, and their scoring."""
