# make demo   a print that fails, on a virtual printer before a simulated webcam; ARGS="--once --json" for a machine
# make test   every test there is
# make lint   style and types
# make translations   collects what people read for translators, and compiles their work

PYTHON ?= python3
OCTOPRINT ?= OctoPrint>=1.11.2
ARGS ?=
VENV := .venv
PIP := $(VENV)/bin/python -m pip --disable-pip-version-check install --quiet --prefer-binary

.PHONY: demo test lint translations clean

demo: $(VENV)/.demo
	@$(VENV)/bin/moop demo $(ARGS)

test: $(VENV)/.test
	@$(VENV)/bin/python -m pytest --numprocesses logical --maxprocesses 4 --dist loadscope --no-loadscope-reorder $(ARGS)

lint: $(VENV)/.test
	$(VENV)/bin/ruff check .
	$(VENV)/bin/ruff format --check .
	$(VENV)/bin/mypy

translations: $(VENV)/.demo
	@$(VENV)/bin/python tools/translations.py

clean:
	rm -rf $(VENV) build dist *.egg-info

$(VENV)/.demo: pyproject.toml setup.py tools/system-packages.sh
	@tools/system-packages.sh $(PYTHON) python gl
	@echo "Installing OctoPrint and this plugin into $(VENV); the first time takes a few minutes ..."
	@test -x $(VENV)/bin/python || $(PYTHON) -m venv $(VENV)
	@$(PIP) --upgrade pip wheel
	@$(PIP) "$(OCTOPRINT)" --editable .
	@touch $@

$(VENV)/.test: $(VENV)/.demo
	@tools/system-packages.sh $(PYTHON) chromium
	@echo "Installing the tools of the tests ..."
	@$(PIP) --editable ".[develop]"
	@touch $@
