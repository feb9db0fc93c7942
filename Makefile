# Needs Python 3.11 or newer, Rust and make; everything else is installed into .venv on the first call.
PYTHON ?= python3
BIN := .venv/bin
RUN := runs/demo
JOBS ?= 2
export WARP_CACHE_PATH ?= $(CURDIR)/.cache/warp
RUST := Cargo.toml rust_ot/Cargo.toml $(wildcard rust_ot/src/*.rs)

.PHONY: demo test check bench bench-ot bench-estimation bench-gap bench-gpu format install clean

demo: install  ## ten recorded Hopper episodes -> distribution -> distance to the truth, about three minutes
	$(BIN)/nfpde collect hopper --target mixture --episodes 10 --out $(RUN)/data
	$(BIN)/nfpde fit hopper $(RUN)/data --params $(RUN)/data/parameters.toml --method softmax --out $(RUN)/fit
	$(BIN)/nfpde evaluate $(RUN)/fit --truth $(RUN)/data/truth.json
	$(BIN)/nfpde fit hopper $(RUN)/data --params $(RUN)/data/parameters.toml --method trajectory --out $(RUN)/trajectory
	$(BIN)/nfpde evaluate $(RUN)/trajectory --truth $(RUN)/data/truth.json

test: install  ## everything that runs on a CPU, JOBS tests at a time with a thread of linear algebra each
	CUDA_VISIBLE_DEVICES= OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(BIN)/python -m pytest -n $(JOBS) --dist worksteal
	cargo test --quiet --workspace

check: install  ## style, types, import rules, documentation
	$(BIN)/ruff check nfpde tests
	$(BIN)/ruff format --check nfpde tests
	$(BIN)/pyright
	$(BIN)/python -m mypy.stubtest nfpde._rust_ot
	$(BIN)/python -m pytest tests/test_architecture.py tests/test_readme.py -k "not runs_in_order"
	cargo fmt --check
	cargo clippy --quiet --workspace --all-targets -- -D warnings

bench-ot: install  ## exact optimal transport beside its peers
	$(BIN)/nfpde bench ot

bench-estimation: install  ## the estimators on all robots, hours; goes on where it stopped
	$(BIN)/nfpde bench estimation
	$(BIN)/nfpde bench estimation --calibration

bench-gap: install  ## hidden faults against the diagnosis: make bench-gap SEED=<one never tried>
	$(BIN)/nfpde bench gap --seed $(SEED)

bench-gpu: install  ## twin tests on an NVIDIA GPU, then losses, fits and diagnoses beside the CPU; goes on where it stopped
	NFPDE_TEST_DEVICE=cuda $(BIN)/python -m pytest tests/test_warp*.py tests/test_sim_alike.py tests/test_gap_device.py
	$(BIN)/nfpde bench devices --device cuda

bench: install  ## the tables of docs/results
	$(BIN)/nfpde bench losses
	$(BIN)/nfpde bench ot
	$(BIN)/nfpde bench fit

format: install
	$(BIN)/ruff check --fix nfpde tests
	$(BIN)/ruff format nfpde tests
	cargo fmt

install: .venv/installed

# uv shares downloads between environments: seconds instead of minutes
.venv/installed: pyproject.toml $(RUST)
	test -x $(BIN)/python || $(PYTHON) -m venv .venv
	test -x $(BIN)/uv || $(BIN)/python -m pip install --quiet uv
	$(BIN)/uv pip install --quiet --python $(BIN)/python --editable ".[dev]"
	touch $@

clean:
	rm -rf .venv target runs .cache
