#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# Finds a Python that the pinned packages exist for and lets it run setup_venv.py. PYTHON, if set, is the one to use;
# otherwise the one that .venv was made with, otherwise the distribution's own if nothing that it needs is missing: it
# is built with optimisation, which Pythons that version managers compile often are not; otherwise the first that fits.
set -eu
here=$(cd "$(dirname "$0")" && pwd)
venv=$here/../.venv/bin/python

fits() {
    "$1" -I -S -c 'import sys; sys.exit(not (3, 11) <= sys.version_info[:2] <= (3, 13))' 2>/dev/null
}

can_make_venv() {
    fits "$1" && lacking=$("$1" -I -S "$here/setup_venv.py" missing 2>/dev/null) && [ -z "$lacking" ]
}

if [ -n "${PYTHON:-}" ]; then
    if ! fits "$PYTHON"; then
        found=$("$PYTHON" --version 2>&1) || found='no Python that runs'
        echo "setup: PYTHON=$PYTHON is $found; 3.11, 3.12 or 3.13 is needed." >&2
        exit 2
    fi
    exec "$PYTHON" -I -S "$here/setup_venv.py" "$@"
fi

if ! fits "$venv" && can_make_venv /usr/bin/python3; then
    exec /usr/bin/python3 -I -S "$here/setup_venv.py" "$@"
fi
for python in "$venv" python3 python3.12 python3.13 python3.11; do
    if fits "$python"; then
        exec "$python" -I -S "$here/setup_venv.py" "$@"
    fi
done
found=$(python3 --version 2>&1) || found='none'
echo "setup: Python 3.11, 3.12 or 3.13 is needed, found: $found. Install it (Debian 12, Ubuntu 24.04:" \
    "apt install python3 python3-venv python3-dev), or name it: make setup PYTHON=/path/to/python3.12" >&2
exit 2
