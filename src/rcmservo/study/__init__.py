"""Many closed loops at once: the laboratory as compiled functions, the servo's step its own; and
the least error that any servo could leave in them."""

from rcmservo.study.batch import Study
from rcmservo.study.course import StudyRun
from rcmservo.study.cramer_rao import Bound, bound

__all__ = ["Bound", "Study", "StudyRun", "bound"]
