#!/bin/sh
# Sets a fresh machine up: an environment in $VENV with every extra and the development tools, and,
# where this user may install them, the two system libraries that pymeshlab needs and mbpoll.
set -eu

venv=${VENV:-.venv}
python=${PYTHON:-python3}

if ! "$python" -c 'import sys; sys.exit(not (3, 11) <= sys.version_info[:2] <= (3, 13))'; then
    echo "loftscan needs Python 3.11 to 3.13; name one: make setup PYTHON=python3.12" >&2
    exit 1
fi

has_library() {
    "$python" -c "import ctypes.util, sys; sys.exit(ctypes.util.find_library('$1') is None)"
}

may_install() {
    [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null
}

install() {
    apt-get update -qq && DEBIAN_FRONTEND=noninteractive apt-get install -y -qq "$@" >/dev/null
}

if ! { has_library GL && has_library OpenGL; }; then
    if may_install; then
        install libgl1 libopengl0
    else
        echo "note: mesh cleanup needs two system libraries: apt-get install libgl1 libopengl0" >&2
    fi
fi

# An independent Modbus master and a tracer that fails and kills for the tests; nothing else needs
# them.
if ! command -v mbpoll >/dev/null && ! { may_install && install mbpoll; }; then
    echo "note: the tests that ask with mbpoll will be skipped: apt-get install mbpoll" >&2
fi
if ! command -v strace >/dev/null && ! { may_install && install strace; }; then
    echo "note: the tests that kill at every write will be skipped: apt-get install strace" >&2
fi

[ -x "$venv/bin/python" ] || "$python" -m venv "$venv"
# Dependency groups need pip 25.1.
"$venv/bin/python" -m pip install --quiet --upgrade 'pip>=25.1'
"$venv/bin/python" -m pip install --quiet --editable '.[all]' --group dev
