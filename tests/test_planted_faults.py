"""The faults of benchmarks/planted_faults.py can be planted: each expression occurs once."""

import planted_faults
import pytest
from planted_faults import FAULTS, Fault


@pytest.mark.parametrize("fault", FAULTS, ids=lambda fault: fault.kind)
def test_a_fault_can_be_planted_and_its_tests_exist(fault: Fault) -> None:
    source = planted_faults.ROOT / "src/rcmservo" / fault.file
    assert source.read_text("utf-8").count(fault.old) == 1
    assert fault.new not in source.read_text("utf-8")
    for name in fault.tests.split():
        assert (planted_faults.ROOT / "tests" / name).exists()
