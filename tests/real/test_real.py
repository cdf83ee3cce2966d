"""Real autopilot programs fly every scenario and keep its bounds; nothing is flown without a build of the user's."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.real.lane import Job, fly_apart, jobs
from tests.real.programs import NOT_GIVEN

FLOWN = [job for job in jobs() if job.can_be_flown]
if not FLOWN:
    pytest.skip(NOT_GIVEN, allow_module_level=True)


@pytest.mark.slow
@pytest.mark.parametrize("job", FLOWN, ids=lambda job: job.name)
def test_a_real_program_keeps_the_bounds_of_its_scenario(job: Job, tmp_path: Path) -> None:
    assert fly_apart(job, tmp_path).broken == ()
