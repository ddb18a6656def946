# Everything else is in pyproject.toml; the licence stands here because setuptools before 77 refuses an SPDX string there.
from setuptools import setup

setup(license="AGPL-3.0-or-later")
