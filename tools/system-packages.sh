#!/bin/sh
# Sees to what pip cannot install: tools/system-packages.sh PYTHON need...
#   python    a virtual environment and a C compiler for it (OctoPrint has a dependency without wheels)
#   gl        OpenGL without a screen; without it the masks are drawn by OpenCV, which is slower
#   chromium  for the tests in a browser
# Installs what is missing where it may (root, or sudo without a password); else prints the command. Fails only where
# nothing can go on without it.
set -u
python=$1
shift
missing="" vital=no

want() { missing="$missing $*"; }

for need in "$@"; do
  case $need in
    python)
      "$python" -c 'import sys; sys.exit(sys.version_info < (3, 9))' || {
        echo "Python 3.9 or newer is needed; $python is $("$python" --version 2>&1). Run make with PYTHON=python3.x."
        exit 1
      }
      "$python" -c 'import ensurepip, venv' 2>/dev/null || { want python3-venv; vital=yes; }
      "$python" -c 'import os, sysconfig, sys; sys.exit(not os.path.exists(sysconfig.get_path("include") + "/Python.h"))' ||
        { want python3-dev; vital=yes; }
      command -v cc >/dev/null || { want gcc libc6-dev; vital=yes; }
      ;;
    gl)
      "$python" -c 'import ctypes; ctypes.CDLL("libEGL.so.1")' 2>/dev/null || want libegl1
      [ -n "$(ls /usr/lib/*/dri/swrast_dri.so /usr/lib/*/libgallium* /usr/lib/dri/swrast_dri.so 2>/dev/null)" ] ||
        want libgl1-mesa-dri
      ;;
    chromium)
      command -v chromium >/dev/null || command -v chromium-browser >/dev/null || command -v google-chrome >/dev/null ||
        want chromium
      ;;
  esac
done
[ -n "$missing" ] || exit 0

install="apt-get install -y --no-install-recommends$missing"
if ! command -v apt-get >/dev/null; then
  echo "Please install what Debian calls:$missing"
elif [ "$(id -u)" = 0 ]; then
  echo "Installing$missing ..."
  { apt-get update -q && DEBIAN_FRONTEND=noninteractive $install; } >/dev/null && exit 0
elif sudo -n true 2>/dev/null; then
  echo "Installing$missing ..."
  { sudo apt-get update -q && sudo DEBIAN_FRONTEND=noninteractive $install; } >/dev/null && exit 0
fi
if command -v apt-get >/dev/null; then
  echo "Not installed:$missing. Please run:  sudo $install"
fi
[ $vital = no ]
