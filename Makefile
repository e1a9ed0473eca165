.PHONY: lock test docs mutants browser format clean
uv := $(or $(shell command -v uv),.uv/bin/uv)

lock: # resolve each requirements*.in again; LOCK=--upgrade takes newer versions
	for name in requirements requirements-mutants requirements-browser; do \
	  $(uv) pip compile --quiet --generate-hashes --universal --python-version 3.11 --no-emit-index-url --no-emit-find-links \
	    --custom-compile-command "make lock" $(LOCK) $$name.in -o $$name.txt || exit; \
	done

test:
	./headland test

docs: # generate the tables and figures in docs/ and README.md from recorded results, configuration and tests
	for name in results protective_field safety scenarios; do \
	  PYTHONPATH=$(CURDIR) PYTHONSAFEPATH=1 .venv/bin/python -m runtime.documents.$$name || exit; \
	done

mutants: # run the remaining mutants of safety/; ONLY=... as in tests/safety/mutants.py
	$(uv) pip install --quiet --python .venv/bin/python --target .mutants --require-hashes --no-build -r requirements-mutants.txt
	PYTHONPATH=$(CURDIR)/.mutants PYTHONSAFEPATH=1 .venv/bin/python tests/safety/mutants.py $(ONLY)

browser: # what the tests of the operator's page in a browser need: Playwright in .browser/, and Debian's chromium
	$(uv) pip install --quiet --python .venv/bin/python --target .browser --require-hashes --no-build -r requirements-browser.txt
	command -v chromium || { [ "$$(id -u)" = 0 ] && apt-get install -y --no-install-recommends chromium; } || \
	  { echo 'missing: chromium. Run: sudo apt-get install -y --no-install-recommends chromium' >&2; exit 1; }

format:
	.venv/bin/python -m ruff check --fix
	.venv/bin/python -m ruff format

clean: # remove the output of set-up and checks; runs/ is kept
	rm -rf .venv .uv .mutants .browser mutants .mypy_cache .pytest_cache .ruff_cache .hypothesis .coverage
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
