"""Runs on disk: schema, writer, reader, replay and outcome, and recordings of others."""
