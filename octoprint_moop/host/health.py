"""What OctoPrint's health check (1.11 and later) hears of this plugin: what keeps the next print from being watched."""

from __future__ import annotations

from typing import Any, Callable


def health_checks(problems: Callable[[], list[str]]) -> list[type]:
    """Classes of checks, as the health check's hook wants them; none where OctoPrint has no such plugin.

    problems : sentences, without looking at a picture or the network
    """
    try:
        from octoprint.plugins.health_check.checks import CheckResult, HealthCheck, Result
    except ImportError:
        return []

    class WatchCheck(HealthCheck):
        key = "moop"

        def perform_check(self, force: bool = False) -> Any:
            found = problems()
            return CheckResult(result=Result.WARNING if found else Result.OK, context={"problems": found})

    return [WatchCheck]
