.PHONY: lock test format clean

lock: # resolve requirements.in anew; LOCK=--upgrade takes newer versions
	uv pip compile --quiet --generate-hashes --universal --python-version 3.11 --no-emit-index-url --no-emit-find-links \
	  --custom-compile-command "make lock" $(LOCK) requirements.in -o requirements.txt

test:
	./headland test

format:
	.venv/bin/python -m ruff check --fix
	.venv/bin/python -m ruff format

clean: # all that set-up and the checks made; runs/ is yours
	rm -rf .venv .uv .mypy_cache .pytest_cache .ruff_cache .hypothesis .coverage
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
