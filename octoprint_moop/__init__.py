"""MOOP, matter out of place: sees a 3D print fail and pauses it at that layer.

Importing this package imports nothing else: the plugin class is loaded when OctoPrint asks for it, so that the core
and the command line run without OctoPrint and a broken native library cannot keep a server from starting.
"""

from __future__ import annotations

__plugin_name__ = "MOOP"
__plugin_pythoncompat__ = ">=3.9,<4"
__plugin_implementation__: object
__plugin_hooks__: dict[str, object]
__plugin_helpers__: dict[str, object]


def __plugin_load__() -> None:
    from .host.plugin import MoopPlugin

    global __plugin_implementation__, __plugin_hooks__, __plugin_helpers__
    plugin = MoopPlugin()
    __plugin_implementation__ = plugin
    __plugin_hooks__ = plugin.hooks()
    __plugin_helpers__ = plugin.helpers()
