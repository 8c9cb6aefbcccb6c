# `make demo` and `make test` do all of their own set-up, in .venv and nowhere else.
PYTHON ?= python3
BIN := .venv/bin
# else each process that a test starts would compile all that it imports
export PYTHONDONTWRITEBYTECODE :=
NATIVE := $(shell find src CMakeLists.txt -name '*.cpp' -o -name '*.h' -o -name '*.hpp' -o -name CMakeLists.txt)

.PHONY: setup demo quick test exhaustive simulate soak coverage lint stubs sanitize docs wheels deb test-wheels lock clean
setup: .venv/.ready

.venv/.ready: pyproject.toml $(NATIVE)
	@.ci/needs $(PYTHON)
	@echo "setting up .venv (takes a minute or two; only after changes of native code)"
	@test -x $(BIN)/python || $(PYTHON) -m venv .venv
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable '.[dev,docs,ros2,trot]'
	@$(BIN)/python -m compileall -q src examples
	@touch $@

demo: setup
	@$(BIN)/poise demo

# what takes long comes first (tests/order.py), so that both workers end together
PYTEST := $(BIN)/python -m pytest -q --dist loadgroup --no-loadscope-reorder
# five at a time on two CPUs, for most tests wait for processes
test: setup
	@$(PYTEST) -n 5 -m "not exhaustive and not wheels"

# what explores or measures for long, builds or deploys code; whole demos and benchmarks:
# two at a time, for they need the CPU
exhaustive: setup
	@$(PYTEST) -n 2 -m exhaustive

# no process, no socket, no sleep
quick: setup
	@$(PYTEST) -n 2 -m "not slow"

# a robot that is broken at random, then the tests again and again in random order, beside
# other work: make soak CHAOS=2h FOR=2h
CHAOS ?= 30min
FOR ?= 1h
soak: setup
	@$(BIN)/python -m tests.chaos $(CHAOS)
	@$(BIN)/python -m tests.soak $(FOR)

# a robot in virtual time, broken by 300 seeds: make simulate, make simulate FOR=2h
simulate: setup
	@$(BIN)/python -m tests.simulation $(if $(filter command line,$(origin FOR)),$(FOR),200)
	@$(BIN)/python -m tests.simulation $(if $(filter command line,$(origin FOR)),$(FOR),50) --robots elects
	@$(BIN)/python -m tests.simulation $(if $(filter command line,$(origin FOR)),$(FOR),50) --robots varied

# lines and branches of src/poise that no test reaches, in all processes; fails below the floor in pyproject.toml
coverage: setup
	@rm -rf build/coverage && mkdir -p build/coverage
	@$(BIN)/coverage run -m pytest -q -n 2 --dist loadgroup --no-loadscope-reorder -m "not wheels"
	@$(BIN)/coverage combine --quiet
	@$(BIN)/coverage report

lint: setup
	@$(BIN)/ruff check .
	@$(BIN)/ruff format --check .
	@$(BIN)/mypy
	@$(BIN)/lint-imports
	@$(BIN)/python .ci/words.py

# The stubs of the native modules, as their signatures say; what they do stands in the headers.
stubs: setup
	@for module in plan/_core estimate/_change_point runtime/_calls simulation/_engine wire/_channel; do \
	  $(BIN)/python -m nanobind.stubgen -q -p .ci/stubs.txt -m poise.$$(echo $$module | tr / .) -o src/poise/$$module.pyi; \
	done
	@$(BIN)/ruff check -q --fix --exit-zero src/poise/*/_*.pyi >/dev/null
	@$(BIN)/ruff format -q src/poise/*/_*.pyi

# All native code under the address and undefined-behaviour sanitizers; without pytest's
# capture, which would swallow what they say, and without its time limit for quick tests.
SITE := .venv/lib/$(shell $(PYTHON) -c 'import sys; print("python%d.%d" % sys.version_info[:2])')/site-packages
sanitize: setup
	@cmake -S . -B build/sanitize -DPOISE_SANITIZE=ON -DPython_EXECUTABLE=$(CURDIR)/$(BIN)/python >/dev/null
	@cmake --build build/sanitize --parallel 2 >/dev/null
	@rm -rf build/sanitize/site && mkdir -p build/sanitize/site
	@cp -r $(SITE)/poise src/poise build/sanitize/site
	@cp build/sanitize/_core*.so build/sanitize/site/poise/plan
	@for part in estimate runtime simulation wire; do \
	  cp build/sanitize/src/poise/$$part/native/*.so build/sanitize/site/poise/$$part; done
	@LD_PRELOAD="$$(gcc -print-file-name=libasan.so) $$(gcc -print-file-name=libstdc++.so)" ASAN_OPTIONS=detect_leaks=0 \
	  PYTHONPATH=build/sanitize/site:$(SITE) $(BIN)/python -S -m pytest -q -s --timeout 600 \
	  -p no:tests.quick tests/plan/test_native.py tests/plan/test_feasibility.py tests/plan/test_core_boundary.py \
	  tests/wire/test_frame.py tests/wire/connections/test_connection.py tests/wire/connections/test_loans.py \
	  tests/wire/connections/test_channel.py \
	  tests/runtime/connectors tests/runtime/execution/test_histogram.py tests/runtime/hosting/test_stats_page.py \
	  tests/runtime/component/test_deadline.py tests/runtime/test_served_call.py \
	  tests/runtime/execution/test_exclusion.py tests/estimate/test_change_point.py tests/simulation/native

# the site in build/docs; a warning is an error
docs: setup
	@mkdir -p build/docs-source/src/poise/estimate
	@for part in README.md CHANGELOG.md CONTRIBUTING.md LICENSE docs examples benchmarks src/poise/estimate/native; do \
	  ln -sfn $(CURDIR)/$$part build/docs-source/$$part; done
	@NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --config-file docs/mkdocs.yml 2>build/docs.log || { cat build/docs.log; exit 1; }

# an sdist, wheels for x86_64 and aarch64, and a bill of materials in dist
wheels: setup
	@$(BIN)/python .ci/wheels.py

# a package for Debian 12, in dist beside the wheels that it needs
deb: setup
	@$(BIN)/python .ci/deb.py

# installs them where there is no compiler
test-wheels: setup
	@$(BIN)/python -m pytest -q -m wheels tests/wheels

# the versions of all packages here and of the tools of `make wheels`; and of what Poise itself needs, with hashes
lock: setup
	@$(BIN)/python .ci/wheels.py tools
	@{ echo "# The versions that the tests ran with, for Python 3.11 to 3.13; \`make lock\` writes this."; \
	  for python in $(BIN) build/wheels/tools/bin; do $$python/python -m pip freeze --exclude-editable; done \
	    | LC_ALL=C sort -fu; } > build/constraints.txt
	@mv build/constraints.txt constraints.txt
	@build/wheels/tools/bin/pip-compile --quiet --generate-hashes --no-header --no-annotate --strip-extras \
	  --no-emit-index-url --no-emit-find-links --no-emit-trusted-host \
	  --constraint constraints.txt --output-file dependencies.txt pyproject.toml

clean:
	rm -rf .venv build dist .pytest_cache .mypy_cache .ruff_cache .import_linter_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
