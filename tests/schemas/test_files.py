"""Files of folders that strangers may have made, and the locks on them."""

from __future__ import annotations

import os
import threading
from pathlib import Path

import pytest

from nmes.schemas.files import lock_kept, open_kept


def test_a_lock_that_goes_in_a_moment_is_waited_for_and_another_is_told(tmp_path: Path) -> None:
    path = tmp_path / "log"
    one, two = open_kept(path), open_kept(path)
    lock_kept(one, path)
    with pytest.raises(BlockingIOError, match="another process has locked it"):
        lock_kept(two, path)
    timer = threading.Timer(0.1, os.close, [one])
    timer.start()
    lock_kept(two, path)  # as after a kill: a child that was about to begin had the lock until it did
    timer.join()
    os.close(two)
