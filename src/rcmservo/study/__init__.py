"""Many closed loops at once: the laboratory as compiled functions, the servo's step its own."""

from rcmservo.study.batch import Study, StudyRun

__all__ = ["Study", "StudyRun"]
