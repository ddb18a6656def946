from __future__ import annotations

import inspect
from functools import partialmethod

from click.testing import CliRunner

# Python 3.9 has no click 8.2, and before that version the runner mixes standard error into standard output.
if "mix_stderr" in inspect.signature(CliRunner.__init__).parameters:
    CliRunner.__init__ = partialmethod(CliRunner.__init__, mix_stderr=False)
