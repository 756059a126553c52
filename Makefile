# Two commands do everything, set-up included:  make demo   and   make test
.DEFAULT_GOAL := build
.PHONY: setup build addon python demo test asan tsan fuzz faults format bench clean

# What the program, its detectors and `mirage demo` are built from and run with.
DEMO_PACKAGES := g++ cmake ninja-build ccache libeigen3-dev libtbb-dev libspdlog-dev libfmt-dev nlohmann-json3-dev \
  libtomlplusplus-dev librandom123-dev libboost-dev libcli11-dev libembree-dev libopenimageio-dev libceres-dev libopenexr-dev \
  libtinygltf-dev libopencv-imgproc-dev libhwy-dev libnova-dev libtinyxml2-dev libpagmo-dev liblcms2-dev libopenmpi-dev libtorch-dev libssl-dev \
  libopenblas0-pthread libtcmalloc-minimal4 libturbojpeg0-dev zlib1g-dev blender python3-numpy python3-jinja2 python3-pil
# What the Python module and the tests take besides.
TEST_PACKAGES := python3-matplotlib python3-scipy python3-dev pybind11-dev python3-torch python3-wheel openmpi-bin xvfb xauth libgl1-mesa-dri \
  libgtest-dev libgmock-dev librapidcheck-dev libbenchmark-dev clang-format clang-tidy doxygen strace nodejs npm chromium \
  mkdocs mkdocs-material
PACKAGES := $(DEMO_PACKAGES) $(TEST_PACKAGES)
# What Debian 13 has and 12 has not: --detector onnx and its tests.
NEWER_PACKAGES := libonnxruntime-dev python3-onnx

# Parts of the sources that clang-format owns.
SOURCES := $(shell git ls-files '*.h' '*.cpp' 2>/dev/null)

export CCACHE_BASEDIR := $(CURDIR)
export CCACHE_NOHASHDIR := 1
export CCACHE_SLOPPINESS := pch_defines,time_macros,include_file_mtime,include_file_ctime
export MIRAGE_KITTI ?= $(CURDIR)/../shared/kitti
export MIRAGE_GOLDEN ?= $(CURDIR)/../shared/golden/softras.json

# Installs what is missing, and nothing when nothing is. A node that did not come from Debian will do.
INSTALLED = dpkg-query -W -f='$${Status}' $$p 2>/dev/null | grep -q 'install ok installed'
setup:
	@missing=""; for p in $(PACKAGES); do \
	  $(INSTALLED) && continue; \
	  case $$p in nodejs) command -v node >/dev/null && continue;; npm) command -v npm >/dev/null && continue;; esac; \
	  missing="$$missing $$p"; done; \
	[ -z "$$missing" ] || apt-get update -q; \
	for p in $(NEWER_PACKAGES); do \
	  apt-cache show $$p >/dev/null 2>&1 || break; $(INSTALLED) || missing="$$missing $$p"; done; \
	if [ -n "$$missing" ]; then echo "installing:$$missing"; \
	  DEBIAN_FRONTEND=noninteractive apt-get install -y -q --no-install-recommends $$missing; fi

CONFIGURE := cmake --preset release
build: setup
	$(CONFIGURE)
	cmake --build --preset release

# The Blender add-on as a zip for Edit > Preferences > Add-ons > Install.
addon:
	python3 plugins/blender/pack.py build/mirage_blender.zip

# The Python package in build/python, and its wheel in build/: for Debian's Python, and with PYTHON=… for another one as well.
python: setup
	cmake --preset release -DMIRAGE_OTHER_PYTHON=$(PYTHON)
	cmake --build --preset release --target $(if $(PYTHON),mirage_other_python,mirage_python)
	ln -sfn release/python build/python
	/usr/bin/python3 -B plugins/python/pack_wheel.py build/release/python build $(PYTHON)

# Installs and builds only what the demo runs: no tests, no Python module. `make test` configures the same folder for all of it.
demo: PACKAGES := $(DEMO_PACKAGES)
demo: NEWER_PACKAGES :=
demo: setup
	cmake --preset demo
	cmake --build --preset demo
	build/release/mirage demo --out out/demo

test: metrics build
	ctest --preset release -j2

asan: setup
	cmake --preset asan
	cmake --build --preset asan
	ctest --preset asan -j2

# The parallel loops under ThreadSanitizer: the layers that have most of them.
TSAN_LAYERS ?= base geometry sensors scene simulation generator frames
tsan: setup
	cmake --preset tsan
	cmake --build --preset tsan --target $(TSAN_LAYERS:%=test_%)
	for layer in $(TSAN_LAYERS); do MIRAGE_CACHE=off TSAN_OPTIONS="suppressions=$(CURDIR)/tests/tsan.supp" \
	  build/tsan/test_$$layer || exit; done

# Every parser under libFuzzer for FUZZ_SECONDS each (CONTRIBUTING.md). Needs clang, as nothing else does.
FUZZ_SECONDS ?= 60
fuzz: PACKAGES += clang
fuzz: setup
	cmake --preset fuzz
	cmake --build --preset fuzz
	tests/fuzz/run.py build/fuzz --seconds $(FUZZ_SECONDS) $(FUZZ_PARSERS)

# Every injected fault and KILLS kills (CONTRIBUTING.md); make test does a part of it.
KILLS ?= 100
faults: build
	python3 -B tests/faults/run.py . build/release --kills $(KILLS)
	python3 -B tests/faults/refusals.py . build/release

bench: build
	cmake --build --preset release --target mirage_bench
	build/release/mirage_bench
	python3 -B validation/benchmarks/rank_efficiency.py build/release/mirage --json build/release/bench.json
	python3 -B validation/benchmarks/fleet_cost.py build/release/mirage --json build/release/bench.json
	PYTHONPATH=build/release/python /usr/bin/python3 -B validation/benchmarks/python_overhead.py --json build/release/bench.json

.PHONY: reference evidence site metrics

# The pages: commands from --help, tables and plots of the evidence from validation/results, and all of them as a site in build/site.
reference: build
	/usr/bin/python3 -B src/guide/reference.py build/release/mirage src/guide/commands.md

evidence:
	/usr/bin/python3 -B src/guide/evidence.py .

site: setup
	/usr/bin/python3 -B src/guide/site.py . build/site

# Words, lines, files, weights and casts.
metrics:
	@python3 -B src/guide/metrics.py .

.PHONY: deb deb-test system-test portable manual docs

# Debian packages in build/, checked by lintian; and one of them installed in a fresh Debian (as root, by debootstrap).
DEB := mirage-simulator_0.1.0_$(shell dpkg --print-architecture 2>/dev/null).deb
deb: manual
	@$(MAKE) --no-print-directory setup PACKAGES="lintian dpkg-dev file"
	cd build/release && cpack -G DEB
	lintian --allow-root --fail-on error build/$(DEB) build/$(subst simulator_,simulator-dev_,$(DEB))

deb-test: deb
	@$(MAKE) --no-print-directory setup PACKAGES="debootstrap"
	src/packaging/package_test.sh build/$(DEB)

# make demo and make test of the last commit in a bare Debian SUITE (as root, by debootstrap): a table of seconds and failures. With
# ARCH=arm64 `make portable` alone, run by qemu.
SUITE ?= trixie
system-test:
	@$(MAKE) --no-print-directory setup NEWER_PACKAGES= PACKAGES="debootstrap $(if $(ARCH),qemu-user-static binfmt-support dpkg-dev)"
	src/packaging/system_test.sh $(SUITE) "" $(ARCH)

# The simulator without detectors, and its tests. With ARCH and CROSS (arm64, aarch64-linux-gnu) for that processor, by this machine's
# cross compiler; then its programs must run here, as qemu lets them.
PORTABLE := base geometry sensors
PORTABLE_BUILD = build/portable$(ARCH:%=-%)
ANY_PROCESSOR := cmake ninja-build libeigen3-dev nlohmann-json3-dev librandom123-dev libcli11-dev
PORTABLE_PACKAGES := $(filter-out g++ ccache blender libtorch-dev python3-%,$(DEMO_PACKAGES)) libgtest-dev libgmock-dev librapidcheck-dev
portable: NEWER_PACKAGES :=
portable: PACKAGES = $(filter $(ANY_PROCESSOR),$(PORTABLE_PACKAGES)) g++$(CROSS:%=-%) \
  $(patsubst %,%$(ARCH:%=:%),$(filter-out $(ANY_PROCESSOR) $(CROSS:%=libopenmpi-dev),$(PORTABLE_PACKAGES)))
portable: setup
	cmake --preset portable -B $(PORTABLE_BUILD) $(if $(CROSS),\
	  -DCMAKE_SYSTEM_NAME=Linux -DCMAKE_SYSTEM_PROCESSOR=$(firstword $(subst -, ,$(CROSS))) -DCMAKE_C_COMPILER=$(CROSS)-gcc \
	  -DCMAKE_CXX_COMPILER=$(CROSS)-g++ -DMPI_SKIP_COMPILER_WRAPPER=ON -DMPI_C_HEADER_DIR=/usr/lib/$(CROSS)/openmpi/include \
	  -DMPI_C_LIB_NAMES=mpi -DMPI_mpi_LIBRARY=/usr/lib/$(CROSS)/openmpi/lib/libmpi.so)
	cmake --build $(PORTABLE_BUILD) --target mirage $(PORTABLE:%=test_%)
	for layer in $(PORTABLE); do MIRAGE_CACHE=off $(PORTABLE_BUILD)/test_$$layer || exit; done

# Pages for `man`, from --help; the API's pages, from the public headers.
manual: build
	@$(MAKE) --no-print-directory setup PACKAGES="help2man"
	$(CONFIGURE)
	cmake --build --preset release --target manual

docs: setup
	cmake --preset release
	cmake --build --preset release --target docs

format:
	clang-format -i $(SOURCES)

clean:
	rm -rf build
