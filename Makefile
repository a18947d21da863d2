# `make help` lists the targets.
VENV := .venv
PYTHON := $(VENV)/bin/python
export VIRTUAL_ENV := $(CURDIR)/$(VENV)

.PHONY: help quick test test-full dist test-aarch64 test-examples check golden bench bench-registration models wheel manylinux results pictures fuzz
.DEFAULT_GOAL := help

help:  ## this list
	@grep -hE '^[a-z0-9-]+:.*##' $(MAKEFILE_LIST) | sed 's/:.*##/\t/'

# uv knows where PyTorch is without CUDA, which PyPI does not have for Linux. Where it cannot reach that, the build with CUDA is
# installed, 4.5 GB more: by uv in a tenth of the time, or by pip, which may know of another index.
TEST_PACKAGES := "maturin>=1.16" -e "training[test]"
$(VENV)/ready: python/pyproject.toml training/pyproject.toml
	python3 -m venv $(VENV)
	$(PYTHON) -m pip install --quiet --upgrade pip uv
	$(VENV)/bin/uv pip install --quiet --torch-backend=cpu $(TEST_PACKAGES) || { \
		echo "PyTorch without CUDA cannot be reached: installing the default" && \
		{ $(VENV)/bin/uv pip install --quiet $(TEST_PACKAGES) || $(PYTHON) -m pip install --quiet $(TEST_PACKAGES); }; \
	}
	touch $@

$(VENV)/check-ready: $(VENV)/ready
	$(PYTHON) -m pip install --quiet ruff "pyright[nodejs]"
	touch $@

$(VENV)/bench-ready: $(VENV)/ready
	$(PYTHON) -m pip install --quiet -e "training[bench]"
	touch $@

# Builds the Python module into the virtual environment.
.PHONY: module
module: $(VENV)/ready
	$(VENV)/bin/maturin develop --release --quiet --manifest-path python/Cargo.toml

# With the program among them, the crates have the features of the first command.
QUICK := -p snake-kernels -p snake-geometry -p snake-core -p snake-keypoints
quick:  ## after every edit, three minutes: format, lints, kernels, core, command line
	cargo fmt --check
	cargo clippy --release --all-targets
	cargo test --release $(QUICK) --lib -- --skip control::tests
	cargo test --release $(QUICK) --test cli -- detect:: register:: usage:: outputs::

# The Python module by itself has the features of the workspace: each crate is compiled once. tests/test_embedding.py runs what
# is compiled here.
NIGHTLY = -m "not nightly"
TEST := test test-full
$(TEST): export PYO3_BUILD_EXTENSION_MODULE := 1
$(TEST): export PYTHONPATH := $(CURDIR)/python
test-full: export SNAKE_FULL := 1
test-full: NIGHTLY :=
test:  ## all tests: Rust, Python module, training, parity with PyTorch; prints the ten slowest
test-full:  ## also whole grids, of which `make test` tests one of each kind: for the night
$(TEST): $(VENV)/ready
	cargo build --release --workspace --lib --bins --tests --examples
	cp target/release/lib_core.$(if $(filter Darwin,$(shell uname)),dylib,so) python/snake_rs/_core.abi3.so
	python3 tools/rust_tests.py --workspace
	OMP_NUM_THREADS=1 $(PYTHON) -m pytest -q -rs --durations=10 $(NIGHTLY) --numprocesses 2 --dist loadfile tests training/tests

# Each has hundreds of dependencies of its own. The page needs wasm32-unknown-unknown, Node.js and Chromium.
test-examples:  ## the examples outside the workspace: Dora, Rerun and the page for a browser; half an hour
	for name in dora_node rerun_view; do (cd examples/$$name && cargo test --release) || exit 1; done
	cd examples/wasm_page && page=$$(python3 build.py) && \
		node --experimental-websocket test.mjs "$${page%% *}" ../../samples/plane.ply

ARM := aarch64-unknown-linux-gnu
ARM_CARGO := CARGO_TARGET_AARCH64_UNKNOWN_LINUX_GNU_LINKER=aarch64-linux-gnu-gcc \
	CARGO_TARGET_AARCH64_UNKNOWN_LINUX_GNU_RUNNER="qemu-aarch64 -L /usr/aarch64-linux-gnu" cargo test --release --target $(ARM)
# The tests of the field that take seconds: whole detections take minutes under emulation.
ARM_TESTS := golden:: decoder:: encoder:: lattice:: modes::
test-aarch64:  ## the kernels and the field under emulation, with NEON; needs qemu-user, gcc-aarch64-linux-gnu and the Rust target
	@command -v qemu-aarch64 >/dev/null || { echo "qemu-aarch64 is missing: apt-get install qemu-user"; exit 1; }
	@command -v aarch64-linux-gnu-gcc >/dev/null || { echo "the linker is missing: apt-get install gcc-aarch64-linux-gnu"; exit 1; }
	@test -d "$$(rustc --print target-libdir --target $(ARM))" || { echo "rustup target add $(ARM)"; exit 1; }
	$(ARM_CARGO) -p snake-kernels --lib --tests
	$(ARM_CARGO) -p snake-geometry --lib
	$(ARM_CARGO) -p snake-core --lib -- $(ARM_TESTS)

check: $(VENV)/check-ready wheel-test packages sdist  ## formatting, lints, stubs, documentation, other crates, packages, the wheel
	cargo fmt --check
	cargo clippy --release --workspace --all-targets
	RUSTDOCFLAGS="-D warnings" cargo doc --release --workspace --no-deps
	$(VENV)/bin/ruff check training python tests docs tools
	$(VENV)/bin/ruff format --check training python tests docs tools
	$(PYTHON) -m mypy --strict python/snake_rs
	$(VENV)/bin/pyright --pythonpath $(PYTHON) python/snake_rs
	$(PYTHON) python/third_party_licenses.py --check

# Cargo would verify the packages by compiling each of them apart, which takes six times as long: here they share what they compile. Each
# is checked by itself, without its features and with the default ones: together, one would bring the features that another lacks. Of
# files in packages the times are constant: without -m, Cargo would take changed ones for checked.
.PHONY: packages
packages:  # the package of each crate compiles without the rest of the repository, without and with its default features
	rm -rf target/package
	cargo package --workspace --exclude snake-rs-python --allow-dirty --no-verify
	cd target/package && for crate in *.crate; do tar -xmzf $$crate; done
	cd target/package && { \
		printf '[workspace]\nresolver = "3"\nmembers = ["*[0-9]"]\n[patch.crates-io]\n'; \
		for folder in *[0-9]; do echo "$${folder%-*} = { path = \"$$folder\" }"; done; \
	} > Cargo.toml
	cp Cargo.lock target/package
	cd target/package && for folder in *[0-9]; do for features in --no-default-features ""; do \
		CARGO_TARGET_DIR=$(CURDIR)/target cargo check --release --quiet -p $${folder%-*} $$features || exit 1; \
	done; done

.PHONY: sdist
sdist: $(VENV)/ready  # the source distribution of the Python module compiles by itself
	rm -rf target/sdist
	$(VENV)/bin/maturin sdist --manifest-path python/Cargo.toml --out target/sdist
	cd target/sdist && tar -xmzf snake_rs-*.tar.gz
	CARGO_TARGET_DIR=$(CURDIR)/target cargo check --release --manifest-path target/sdist/snake_rs-*/python/Cargo.toml

golden: $(VENV)/ready  ## check the golden files against the PyTorch networks
	$(PYTHON) -m pytest -q training/tests/test_golden.py

bench: module $(VENV)/bench-ready  ## speed beside PyTorch and OpenVINO
	$(PYTHON) tests/bench/speed.py

$(VENV)/registration-ready: $(VENV)/ready
	$(PYTHON) -m pip install --quiet -e "training[registration]"
	touch $@

bench-registration: module $(VENV)/registration-ready  ## registration beside Open3D and KISS-Matcher: make bench-registration SCENES=FOLDER OBJECTS=FOLDER; hours, goes on where it stopped
	$(PYTHON) tests/bench/registration.py $(if $(SCENES),--scenes $(SCENES)) $(if $(OBJECTS),--objects $(OBJECTS))

models: module  ## all weights from their recipes into runs/: make models DATA=FOLDER VAL=FOLDER adds shapes, SMOKE=1 only sees that it runs; days, resumable, each recipe states its time
	OMP_NUM_THREADS=1 $(PYTHON) -m snake_training.recipes training/recipes/*.toml $(if $(DATA),--data $(DATA)) \
		$(if $(VAL),--validation-data $(VAL)) $(if $(SMOKE),--smoke --run-dir runs/smoke)

models/paper.safetensors: $(sort $(wildcard models/paper.safetensors.?))  ## the paper's network, joined from its parts
	cat $^ > $@

results: module  ## docs/results.md: make results OBJECTS=FOLDER LANDMARKS=FOLDER BODIES=FOLDER SURFACES=FOLDER SCENES=FOLDER (or one of them), LIMIT=NUMBER of objects; resumable
	$(PYTHON) docs/results.py $(if $(OBJECTS),--objects $(OBJECTS)) $(if $(LANDMARKS),--landmarks $(LANDMARKS)) $(if $(BODIES),--bodies $(BODIES)) $(if $(SURFACES),--surfaces $(SURFACES)) $(if $(SCENES),--scenes $(SCENES)) $(if $(LIMIT),--limit $(LIMIT))

pictures: module  ## every picture of the pages: make pictures DATA=FOLDER (objects/ and scenes/); the page needs Chromium
	cargo build --release --bin snake-cli
	$(PYTHON) -m pip install --quiet pillow
	PATH="$(CURDIR)/target/release:$$PATH" $(PYTHON) docs/pictures.py $(if $(DATA),--data $(DATA))

dist: manylinux  ## target/dist: an archive of the program with completions and licences, and the wheel
	python3 tools/dist.py
	cp "$$(ls -t target/wheels/snake_rs-*manylinux*.whl | head -n 1)" target/dist

wheel: $(VENV)/ready  ## a wheel of the Python module in target/wheels
	$(VENV)/bin/maturin build --release --manifest-path python/Cargo.toml

# Without Zig, a wheel needs the C library of the machine that built it, or a newer one.
manylinux: $(VENV)/ready  ## a wheel for Linux with glibc 2.17 (2014) or newer
	$(PYTHON) -m pip install --quiet ziglang
	PATH="$(CURDIR)/$(VENV)/bin:$$PATH" maturin build --release --manifest-path python/Cargo.toml --zig --compatibility manylinux2014

# PATH has no cargo, and pip may take only wheels: nothing can be compiled.
WITHOUT_RUST := env PATH=$(CURDIR)/target/wheel-test/bin:/usr/bin:/bin
.PHONY: wheel-test
wheel-test: wheel  # installs the wheel in a new environment without Rust, and detects keypoints there, in Python and by its command
	rm -rf target/wheel-test && $(PYTHON) -m venv target/wheel-test
	$(WITHOUT_RUST) python -m pip install --quiet --only-binary :all: \
		"$$(ls -t target/wheels/snake_rs-*-cp310-abi3-*.whl | head -n 1)"
	cd target && $(WITHOUT_RUST) python -c "import numpy, snake_rs; \
		print(snake_rs.detect(numpy.random.default_rng(0).normal(size=(2000, 3))))"
	cd target && $(WITHOUT_RUST) snake-cli detect ../samples/plane.ply -o wheel-test/keypoints.laz --max-keypoints 3

fuzz: SECONDS ?= 600
fuzz:  ## search for bytes that break a reader, ten minutes for each: make fuzz SECONDS=60; needs cargo install cargo-fuzz
	python3 -m zipfile -e fuzz/corpus.zip fuzz/target/stored
	cd fuzz && for target in $$(cargo fuzz list); do \
		mkdir -p target/corpus/$$target && \
		cargo fuzz run --release --sanitizer none $$target target/corpus/$$target target/stored/$$target -- \
			-max_total_time=$(SECONDS) -max_len=8192 -rss_limit_mb=1024 -timeout=10 -verbosity=0 || exit 1; \
	done
