"""Records of runs on disk: message layout, writer, reader, replay, timeline and outcome."""
