"""Many closed loops at once: the laboratory as compiled functions, the servo's step its own."""

from rcmservo.study.batch import StudyRun, Study

__all__ = ["StudyRun", "Study"]
