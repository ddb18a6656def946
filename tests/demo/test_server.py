"""The demo's server is a real OctoPrint."""

from __future__ import annotations

import os
import socket

import pytest

pytest.importorskip("octoprint")

from octoprint_moop.demo.server import DemoServer, ServerError


def test_the_server_has_the_plugin_a_printer_and_an_administrator_and_leaves_no_process_behind(tmp_path):
    with DemoServer(tmp_path, snapshot_url="http://127.0.0.1:9/?action=snapshot") as server:
        plugins = {plugin["key"]: plugin for plugin in server.api("GET", "/plugin/pluginmanager/plugins")["plugins"]}
        assert plugins["moop"]["enabled"]
        assert "admins" in server.api("GET", "/api/currentuser")["groups"]
        assert server.api("GET", "/api/settings")["webcam"]["snapshotUrl"] == "http://127.0.0.1:9/?action=snapshot"
        assert server.job_state() == "Operational"
        group = server._process.pid
    with pytest.raises(ProcessLookupError):
        os.killpg(group, 0)


def test_a_folder_can_be_used_again_and_a_taken_port_is_named(tmp_path):
    for _ in range(2):
        with DemoServer(tmp_path) as server:
            assert server.api("GET", "/api/currentuser")["name"] == server.user
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        with pytest.raises(ServerError, match=f"Port {port}"):
            DemoServer(tmp_path, port=port).start()


def test_an_interpreter_without_octoprint_is_named_in_the_error(tmp_path):
    with pytest.raises(ServerError, match="/bin/false"):
        DemoServer(tmp_path, octoprint_python="/bin/false").start()
