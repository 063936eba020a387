"""Plan of a study: methods, distributions of scenes and conditions, combined into cells."""
