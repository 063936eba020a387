"""The paper's boxes composed into one pure step."""
