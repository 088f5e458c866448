# make demo    sets up what the daemon needs (no torch) and shows it at work, without any hardware
# make test    sets up everything and runs the quick tests
# make help    lists the rest

.DEFAULT_GOAL := help
.PHONY: help demo setup test test-slow test-systemd check lint format expectations bench soak mutants lock install \
	install-program install-files deb uninstall clean

# The first interpreter that fits and can make a virtual environment; make PYTHON=/path/to/python3.11 names another.
FITS := import sys; sys.exit(not (3, 10) <= sys.version_info[:2] <= (3, 14))
CANDIDATES := python3 python3.14 python3.13 python3.12 python3.11 python3.10
PYTHON ?= $(shell for python in $(CANDIDATES); do \
	$$python -c 'import ensurepip, venv; $(FITS)' 2>/dev/null && command -v $$python && exit; done)

# Fails with advice if no Python fits.
define check-python
test "$$(uname -s)" = Linux || { echo "touchd runs on Linux alone; elsewhere, use a virtual machine or WSL 2"; exit 1; }; \
for python in $(or $(PYTHON),$(CANDIDATES)); do \
  $$python -c '$(FITS)' 2>/dev/null || continue; \
  $$python -c 'import sys; sys.exit(sys.maxsize < 2**32)' || { \
    echo "$$python is for 32 bits; touchd needs a 64-bit system, since ONNX Runtime is there for no other"; exit 1; }; \
  $$python -c 'import ensurepip, venv' 2>/dev/null && exit 0; \
  echo "$$python cannot make a virtual environment; on Debian or Ubuntu: sudo apt install python3-venv"; exit 1; \
done; \
echo "touchd needs Python 3.10 to 3.14 and found none; install one, or: make PYTHON=/path/to/python3.11"; exit 1
endef

VENV := .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip install --disable-pip-version-check

# requirements.lock begins with what touchd and the live page need. A section for each other extra follows;
# EXTRAS=mqtt or EXTRAS=mqtt,ros2 installs it too. An upgrade without EXTRAS keeps those that are installed.
OTHER_EXTRAS := mqtt lsl ros2 rosbridge mcap nao
EXTRAS ?= $(filter $(OTHER_EXTRAS),$(shell $(DESTDIR)$(PROGRAM)/bin/python -m touchd.drivers.installed 2>/dev/null))
comma := ,
WANTED = $(subst $(comma), ,$(EXTRAS))
LOCKED = awk -v wanted=' $(WANTED) ' 'BEGIN {take = 1} /^\# extra: / {take = index(wanted, " " $$3 " ")} take' \
  requirements.lock
define check-extras
unknown='$(filter-out live $(OTHER_EXTRAS),$(WANTED))'; test -z "$$unknown" || \
  { echo "there is no extra $$unknown; EXTRAS takes $(OTHER_EXTRAS)"; exit 1; }
endef

# The index from which development gets torch. Without an NVIDIA GPU: that of the build for CPUs, 1 GB on the disk.
# TORCH_INDEX= (empty): the ordinary index, with CUDA, 6 GB; for GPUs, or where the other cannot be reached.
TORCH_ON_CPU := https://download.pytorch.org/whl/cpu
TORCH_INDEX ?= $(if $(shell command -v nvidia-smi),,$(TORCH_ON_CPU))
RUNTIME := $(VENV)/.runtime.stamp
DEVELOPMENT := $(VENV)/.development.stamp

help:
	@echo "make demo          set up what the daemon needs and show it at work, without any hardware"
	@echo "make test          set up everything and run the quick tests"
	@echo "make test-slow     run the tests that take minutes"
	@echo "make test-systemd  install the service in a Debian container and try it there (root, systemd-container)"
	@echo "make check         ruff and mypy"
	@echo "make bench         latency, processor, memory and start-up of the real daemon"
	@echo "make soak          24 hours of sensor time flat out: nothing grows, nothing is lost (half an hour)"
	@echo "make expectations  rebuild the expected events beside the recordings in tests/recordings (ADD=FILE adds one)"
	@echo "make mutants       put small faults into FILES, one at a time, and list those that TESTS let through"
	@echo "make install       put the service in place, or upgrade it (sudo; EXTRAS, PREFIX); make uninstall removes it"
	@echo "make deb           build a Debian package in dist/, with the same layout"
	@echo "make lock          renew the versions that make and CI install"
	@echo "make setup         set up what the daemon needs: $(BIN)/touchd"
	@echo "make clean         remove $(VENV) and what tools left behind"

demo: $(RUNTIME)
	@$(BIN)/touchd demo

setup: $(RUNTIME)

test: $(DEVELOPMENT)
	$(BIN)/python -m pytest

test-slow: $(DEVELOPMENT)
	$(BIN)/python -m pytest -m slow

test-systemd: $(DEVELOPMENT)
	$(BIN)/python -m pytest -n 0 -s tests/by_hand/real_systemd.py

check: $(DEVELOPMENT)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

format: $(DEVELOPMENT)
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

bench: $(RUNTIME)
	@$(BIN)/touchd bench

# With the memory settings of the unit.
soak: $(RUNTIME)
	$$(sed -n 's/^Environment=/env /p' systemd/touchd.service) PYTHONPATH=.:tests $(BIN)/python -m by_hand.soak --out model/studies/stored/soak.json

expectations: $(RUNTIME)
	PYTHONPATH=tests $(BIN)/python -m rigs.pairs $(if $(ADD),--add $(ADD))

# cosmic-ray gets its own environment, as nothing else needs it. With only the tests about the file it takes minutes.
# SAMPLE: how many faults, drawn at random; 0 for all.
MUTATION := $(VENV)/mutation
TESTS ?= tests
SAMPLE ?= 0
mutants: $(DEVELOPMENT)
	@test -n '$(FILES)' || { echo 'make mutants FILES=daemon/path/decide.py TESTS=tests/daemon/test_decide.py'; exit 1; }
	@test -e $(MUTATION)/bin/cosmic-ray || { $(BIN)/python -m venv $(MUTATION) && \
	  $(MUTATION)/bin/python -m pip install -q --disable-pip-version-check 'cosmic-ray>=8.7,<9'; }
	@PYTHONPATH=.:tests nice -n 15 $(BIN)/python -m by_hand.mutants --tool $(MUTATION) --sample $(SAMPLE) \
	  --tests '$(TESTS)' $(FILES)

# PREFIX/touchd becomes the service's own virtual environment. DESTDIR: where a package is assembled. BINDIR: where the
# command is linked, for every shell. SYSTEM: where systemd and udev look, /usr/lib in a package.
PREFIX ?= /opt
BINDIR ?= /usr/local/bin
SYSTEM ?= /etc
PROGRAM := $(PREFIX)/touchd
COMMAND := $(DESTDIR)$(BINDIR)/touchd
UNITS := $(DESTDIR)$(SYSTEM)/systemd/system
NEW := $(DESTDIR)$(PROGRAM).new
ETC := $(DESTDIR)/etc

install: install-program install-files

# The new program is built beside the old one, which keeps running until they are swapped. A failed upgrade, perhaps
# without a network, leaves the old one unchanged.
install-program:
	@$(check-python)
	@$(check-extras)
	@case "$$(readlink -f "$$(command -v $(PYTHON))")" in /home/*|/root/*) \
	  echo "$(PYTHON) is in a home folder, which the service cannot see; make install PYTHON=/usr/bin/python3"; exit 1;; esac
	@if test -e $(DESTDIR)$(PROGRAM) && ! test -e $(DESTDIR)$(PROGRAM)/pyvenv.cfg; then \
	  echo "$(DESTDIR)$(PROGRAM) is there and is not an installed touchd; make install PREFIX=/another/folder"; exit 1; fi
	@echo "Installing $(PROGRAM) with live $(WANTED) (a minute or two)"
	@rm -rf build $(NEW)
	@umask 022; $(PYTHON) -m venv $(NEW)
	@$(LOCKED) > $(NEW)/requirements.lock
	@umask 022; pip='$(NEW)/bin/python -m pip install -qq --disable-pip-version-check'; \
	  { $$pip --require-hashes -r $(NEW)/requirements.lock && $$pip --no-deps --no-build-isolation .; } || \
	  { rm -rf $(NEW); exit 1; }
	@rm -rf build *.egg-info
	@grep -rlIF "$(NEW)" $(NEW)/bin $(NEW)/pyvenv.cfg | xargs -r sed -i 's#$(NEW)#$(PROGRAM)#g'
	@rm -rf $(DESTDIR)$(PROGRAM)
	@mv $(NEW) $(DESTDIR)$(PROGRAM)

# Existing files in /etc/touchd are the user's: an upgrade only replaces the example beside them.
# touchd@NAME is the same service for one of several pads; it reads /etc/touchd/NAME.yaml.
install-files:
	@install -d $(ETC)/touchd $(UNITS) $(DESTDIR)$(BINDIR)
	@sed 's#/opt/touchd#$(PROGRAM)#g' systemd/touchd.service > $(UNITS)/touchd.service
	@sed '1d; s/touchd\.yaml/%i.yaml/; s/^Description=.*/Description=touchd on the pad %i/; s,^StateDirectory=.*,&/%i,; s,^RuntimeDirectory=.*,&-%i,' \
	  $(UNITS)/touchd.service > $(UNITS)/touchd@.service
	@chmod 644 $(UNITS)/touchd.service $(UNITS)/touchd@.service
	@install -D -m 644 systemd/99-touchd.rules $(DESTDIR)$(SYSTEM)/udev/rules.d/99-touchd.rules
	@install -D -m 644 systemd/touchd.sysusers.conf $(DESTDIR)$(SYSTEM)/sysusers.d/touchd.conf
	@install -D -m 644 systemd/touchd.tmpfiles.conf $(DESTDIR)$(SYSTEM)/tmpfiles.d/touchd.conf
	@if test -e $(COMMAND) && ! test -L $(COMMAND); then echo "$(COMMAND) is there and is no link; left as it is"; \
	  else ln -sfn $(PROGRAM)/bin/touchd $(COMMAND); fi
	@install -m 640 daemon/touchd.example.yaml $(ETC)/touchd/touchd.example.yaml
	@test -e $(ETC)/touchd/touchd.yaml || install -m 640 daemon/touchd.example.yaml $(ETC)/touchd/touchd.yaml
ifeq ($(DESTDIR),)
	@systemd-sysusers touchd.conf
	@systemd-tmpfiles --create touchd.conf
	@if test -S /run/udev/control; then udevadm control --reload; udevadm trigger --subsystem-match=tty; fi
	@if test -d /run/systemd/system; then systemctl daemon-reload; systemctl try-restart touchd 'touchd@*'; fi
endif
	@echo "Installed. The configuration is /etc/touchd/touchd.yaml; to start: sudo systemctl enable --now touchd"

# What make install puts in place, with the configuration as a conffile. Runs with the Python it was built with.
PACKAGE := $(CURDIR)/dist/deb
deb:
	@rm -rf $(PACKAGE)
	@mkdir -p dist
	@$(MAKE) --no-print-directory install DESTDIR=$(PACKAGE) BINDIR=/usr/bin SYSTEM=/usr/lib PYTHON=/usr/bin/python3 \
	  > dist/deb.log || { cat dist/deb.log; exit 1; }
	@rm dist/deb.log
	@cp -r systemd/debian $(PACKAGE)/DEBIAN
	@install -d $(PACKAGE)/usr/share/man/man1
	@$(PACKAGE)$(PROGRAM)/bin/python systemd/man.py | gzip -9n > $(PACKAGE)/usr/share/man/man1/touchd.1.gz
	@chmod 755 $(PACKAGE)/DEBIAN $(PACKAGE)/DEBIAN/p*
	@version=$$(sed -n 's/^version = "\(.*\)"/\1/p' pyproject.toml); arch=$$(dpkg --print-architecture); \
	minor=$$(/usr/bin/python3 -c 'import sys; print(sys.version_info.minor)'); \
	sed -i "s/@VERSION@/$$version/; s/@ARCHITECTURE@/$$arch/; s/@PYTHON@/3.$$minor/; s/@NEXT@/3.$$((minor + 1))/" \
	  $(PACKAGE)/DEBIAN/control; \
	dpkg-deb --root-owner-group -Zgzip -z1 --build $(PACKAGE) dist/touchd_$${version}_$$arch.deb
	@rm -rf $(PACKAGE)

# The lock holds hashes for every platform and for Python 3.10 to 3.14, also of pip and setuptools, as venv brings old
# ones. The constraints hold only versions, so that a new tool in pyproject.toml needs no renewal first.
LOCK := $(BIN)/uv pip compile --quiet --universal --python-version 3.10 --custom-compile-command "make lock" pyproject.toml
lock: $(DEVELOPMENT)
	printf 'pip\nsetuptools>=77\n' | $(LOCK) - --upgrade --generate-hashes --no-annotate --extra live \
	  --output-file requirements.lock
	locked=$$(sed -n 's/^\([a-z0-9-]*\)==.*/--no-emit-package=\1/p' requirements.lock); \
	for extra in $(OTHER_EXTRAS); do \
	  printf '\n# extra: %s\n' $$extra >> requirements.lock; \
	  $(LOCK) --generate-hashes --no-annotate --no-header --constraint requirements.lock --extra $$extra $$locked \
	    >> requirements.lock || exit 1; done
	$(LOCK) --upgrade --no-annotate --extra dev --constraint requirements.lock --output-file constraints.txt

uninstall:
ifeq ($(DESTDIR),)
	@if test -d /run/systemd/system && test -e $(UNITS)/touchd.service; then \
	  systemctl --quiet disable touchd touchd@; systemctl stop touchd 'touchd@*'; fi
endif
	@rm -f $(UNITS)/touchd.service $(UNITS)/touchd@.service $(addprefix $(DESTDIR)$(SYSTEM)/,udev/rules.d/99-touchd.rules \
	  sysusers.d/touchd.conf tmpfiles.d/touchd.conf) $(ETC)/touchd/touchd.example.yaml
	@if test "$$(readlink $(COMMAND))" = $(PROGRAM)/bin/touchd; then rm $(COMMAND); fi
	@if test -e $(DESTDIR)$(PROGRAM)/pyvenv.cfg; then rm -rf $(DESTDIR)$(PROGRAM); fi
ifeq ($(DESTDIR),)
	@if test -d /run/systemd/system; then systemctl daemon-reload; fi
	@if test -S /run/udev/control; then udevadm control --reload; fi
endif
	@echo "Removed. Kept: /etc/touchd/touchd.yaml, the journal in /var/lib/touchd, the user touchd"

clean:
	rm -rf $(VENV) build dist *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis

$(BIN)/python:
	@$(check-python)
	@echo "Making $(VENV) with $(PYTHON)"
	@$(PYTHON) -m venv --clear $(VENV)

# names/touchd: where mypy finds the import name, which no folder has. A stamp file each, newer than pyproject.toml,
# so that a second run starts at once.
$(RUNTIME): EXTRAS =
$(RUNTIME): pyproject.toml requirements.lock | $(BIN)/python
	@$(check-extras)
	@echo "Installing what touchd needs (once; a minute or two)"
	@$(LOCKED) > $(VENV)/requirements.lock
	@$(PIP) -q --require-hashes -r $(VENV)/requirements.lock
	@echo "Installing touchd"
	@$(PIP) -qq --no-deps --no-build-isolation --editable .
	@touch $@

$(DEVELOPMENT): pyproject.toml constraints.txt | $(BIN)/python
	@echo "Installing what development and training need (once; some minutes)"
ifneq ($(TORCH_INDEX),)
	@echo "torch from $(TORCH_INDEX): 1 GB on the disk"
	@$(PIP) -qq --retries 1 --timeout 10 --no-deps --constraint constraints.txt --index-url $(TORCH_INDEX) torch \
	  2> $(VENV)/torch.log || { echo "torch cannot be installed from there ($(VENV)/torch.log says why);" \
	  "make test TORCH_INDEX= takes it from the ordinary index, with CUDA: 6 GB"; exit 1; }
else
	@echo "torch from the ordinary index, with CUDA: 6 GB on the disk; Ctrl-C stops it"
endif
	@$(PIP) -qq --constraint constraints.txt --editable '.[dev]'
	@mkdir -p $(VENV)/names && ln -sfn ../.. $(VENV)/names/touchd
	@touch $(RUNTIME) $@
