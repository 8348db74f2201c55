"""What a worker does besides a trial."""

import gc

import pytest

from scso_nlp.studies import work


@pytest.fixture(autouse=True)
def thawed():
    """Other tests need not keep what was there."""
    yield
    gc.unfreeze()


def test_searches_for_cycles_leave_out_what_was_there_before_the_first_trial_and_nothing_later():
    work._leave_imports_out.cache_clear()
    imported = len(gc.get_objects())
    with work._ready():
        pass
    assert len(gc.get_objects()) < imported / 10
    with work._ready():
        made = []
        made.append(made)
    assert any(each is made for each in gc.get_objects())
