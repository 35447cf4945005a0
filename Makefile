# Set-up and the main jobs; `make` alone lists them. Every target may be repeated: what is done already is skipped.

VENV ?= .venv
PYTHONS = $(or $(PYTHON),python3.13 python3.12 python3.11 python3)
PYTEST_ARGS ?=
BASE ?=
CASES ?=
# Versions with which the tests pass; CONSTRAINTS= takes the newest there are.
CONSTRAINTS ?= constraints/newest.txt
GOLDEN_ARGS ?=
BIN = $(VENV)/bin

# The filters and policies multiply small matrices, where BLAS threads only wait for each other.
export OPENBLAS_NUM_THREADS = 1
export OMP_NUM_THREADS = 1
export PIP_DISABLE_PIP_VERSION_CHECK = 1
# Python compiles a module to bytecode when it is first imported; to compile all of torch takes pip half a minute.
# Where it may not keep what it compiled, each of a hundred processes would compile anew what it imports.
export PIP_COMPILE = 0
unexport PYTHONDONTWRITEBYTECODE

.DEFAULT_GOAL := help
.DELETE_ON_ERROR:
.NOTPARALLEL:
.PHONY: help venv install demo docs test check style lint fuzz kills mutants animations study-wheel study-soak soak speed golden clean

help:  ## list the targets
	@echo "make TARGET [PYTHON=python3.12] [VENV=.venv] [PYTEST_ARGS=...]"
	@sed -n 's/^\([a-z-]*\):.*##  *\(.*\)/  \1|\2/p' $(MAKEFILE_LIST) | awk -F'|' '{ printf "%-14s %s\n", $$1, $$2 }'

venv: $(VENV)/.created  ## create the virtual environment (needs Python 3.11 or newer)

install: $(VENV)/.installed-test  ## install the project with everything that its tests need

demo: $(VENV)/.installed-demo  ## set up, run the main job and write its page into demo/
	@echo "== running the demo"
	$(BIN)/offroad demo --out demo

docs: $(VENV)/.installed-test  ## build the documentation site into build/docs, examples included
	@echo "== building the site"
	$(BIN)/python -m sphinx -W --keep-going -q -b html docs build/docs
	@echo "== open build/docs/index.html"

# Types take one processor more than a minute, and say the same before the tests as after them.
test: style  ## set up, check style, floors and types, run the tests
	@echo "== running the tests, and beside them the check of types"
	@$(BIN)/python -m mypy >$(VENV)/types.log 2>&1 & types=$$!; \
	$(BIN)/python -m pytest --numprocesses auto --dist loadfile $(PYTEST_ARGS); tests=$$?; \
	echo "== types"; wait $$types; types=$$?; cat $(VENV)/types.log; \
	[ $$tests -eq 0 ] || exit $$tests; exit $$types

check: $(VENV)/.installed-test  ## slower checks: the built package in an empty environment, the site, long fuzz
	@echo "== running the slower checks"
	$(BIN)/python -m pytest -m check --numprocesses auto --dist loadfile $(PYTEST_ARGS)

style: $(VENV)/.installed-test  ## check style, format and the floors of imports
	@echo "== checking style and the floors of imports"
	$(BIN)/python -m ruff check .
	$(BIN)/python -m ruff format --check .
	$(BIN)/lint-imports --no-logo

lint: style  ## check style, format, the floors of imports and types
	@echo "== checking types"
	$(BIN)/python -m mypy

fuzz: $(VENV)/.installed-test  ## long: 2,400 damaged files of all kinds, each read in a process of its own
	$(BIN)/python benchmarks/fuzz.py

kills: $(VENV)/.installed-test  ## long: benchmark, train, reproduce, diagnose killed at 20 random moments each: the same results?
	OFFROAD_KILLS=20 $(BIN)/python -m pytest -m check tests/check/test_killed.py $(PYTEST_ARGS)

mutants: $(VENV)/.installed-test  ## long: breaks chosen places of the code one by one: does a test notice?
	$(BIN)/python benchmarks/mutants.py

study-wheel: $(VENV)/.installed-test  ## long: wheel forces against an independent evaluation, 2,000 inputs
	$(BIN)/python benchmarks/accuracy_wheel.py

study-soak: $(VENV)/.installed-test  ## long: a million random steps of vehicles, and a million of the environment
	$(BIN)/python -m pytest -m study -k soak $(PYTEST_ARGS)

soak: $(VENV)/.installed-test  ## hours: ten million random steps over all structures and vehicles; goes on where it stopped
	$(BIN)/python benchmarks/soak.py

speed: $(VENV)/.installed-test  ## speed, as ratios to other environments in the same run
	$(BIN)/offroad speed

golden: $(VENV)/.installed-test  ## long: the main commands on BASE=COMMIT and here: the same numbers?
	@[ -n "$(BASE)" ] || { echo "OffroadBekker needs a commit to compare with: make golden BASE=COMMIT" >&2; exit 2; }
	$(BIN)/python benchmarks/golden.py --base "$(BASE)" --cases $(CASES) $(GOLDEN_ARGS)

animations: $(VENV)/.installed-test  ## the animations of docs/scenarios.md
	@for scenario in speed brake climb; do \
	    $(BIN)/offroad drive --scenario $$scenario --agent aware --seed 1 --duration 5 --out out \
	        --video docs/images/$$scenario.gif || exit 1; \
	done

clean:  ## delete caches and what the commands wrote (for a fresh set-up, delete .venv as well)
	rm -rf demo out build dist docs/gallery docs/reference docs/sg_execution_times.rst .hypothesis .import_linter_cache .mypy_cache .pytest_cache .ruff_cache *.egg-info
	find agents benchmarks estimators offroad_env tests -type d -name __pycache__ -prune -exec rm -rf {} + 2>/dev/null || true

# An environment that works is kept. Otherwise the first Python that is new enough and can make one wins.
$(VENV)/.created:
	@probe='import sys; print("%d.%d" % sys.version_info[:2])'; \
	too_old() { [ "$${1%%.*}" -lt 3 ] || { [ "$${1%%.*}" -eq 3 ] && [ "$${1#*.}" -lt 11 ]; }; }; \
	fail() { echo "OffroadBekker $$*" >&2; exit 1; }; \
	if [ -e "$(VENV)" ] && [ ! -e "$(VENV)/pyvenv.cfg" ]; then \
	    fail "will not overwrite $(VENV), which is no virtual environment: move it, or set VENV"; \
	fi; \
	version=$$("$(BIN)/python" -c "import pip; $$probe" 2>/dev/null) || version=0.0; \
	if ! too_old "$$version"; then echo "== keeping $(VENV) (Python $$version)"; exit 0; fi; \
	chosen=; old=; bare=; \
	for name in $(PYTHONS); do \
	    version=$$("$$name" -c "$$probe" 2>/dev/null) || continue; \
	    if too_old "$$version"; then old="$${old:+$$old, }$$name is $$version"; continue; fi; \
	    if ! "$$name" -c 'import ensurepip, venv' 2>/dev/null; then bare="$$name ($$version)"; continue; fi; \
	    chosen=$$name; break; \
	done; \
	if [ -z "$$chosen" ] && [ -n "$$bare" ]; then \
	    fail "cannot create a virtual environment with $$bare: install its venv package" \
	        "(python3-venv on Debian and Ubuntu), or name another Python: make PYTHON=/path/to/python3"; \
	elif [ -z "$$chosen" ]; then \
	    fail "needs Python 3.11 or newer, but found $${old:-none (tried $(PYTHONS))}:" \
	        "install a newer Python, or name one: make PYTHON=/path/to/python3"; \
	fi; \
	echo "== creating $(VENV) with $$chosen (Python $$version)"; \
	"$$chosen" -m venv --clear "$(VENV)"
	@# pip before 23.2 downloads a whole wheel to learn what it needs: gigabytes in the case of torch.
	$(BIN)/python -m pip install --quiet "pip>=23.2"
	@touch $@

$(VENV)/.torch: .ci/install_torch.py $(VENV)/.created
	@echo "== installing torch"
	$(BIN)/python .ci/install_torch.py
	@touch $@

$(VENV)/.installed-demo: pyproject.toml $(VENV)/.torch
	@echo "== installing OffroadBekker with learning and viewing"
	$(BIN)/python -m pip install $(if $(CONSTRAINTS),--constraint $(CONSTRAINTS)) --editable ".[rl,view]"
	@touch $@

$(VENV)/.installed-test: pyproject.toml $(VENV)/.torch
	@echo "== installing OffroadBekker with everything"
	$(BIN)/python -m pip install $(if $(CONSTRAINTS),--constraint $(CONSTRAINTS)) --editable ".[all,dev]"
	@touch $(VENV)/.installed-demo $@
