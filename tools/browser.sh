#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Prints the path of a Chromium for the tests of the page. Where there is none, installs Debian's as root;
# otherwise says in one line what to install and ends with 1.
set -euo pipefail

find_browser() {
    local name
    for name in "${ROSETTE_BROWSER:-}" chromium chromium-browser google-chrome google-chrome-stable; do
        [ -n "$name" ] && command -v "$name" && return 0
    done
    return 1
}

find_browser && exit 0
if [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null; then
    {
        apt-get update -qq &&
            DEBIAN_FRONTEND=noninteractive apt-get install -qq -y --no-install-recommends chromium
    } >&2 </dev/null || true
    find_browser && exit 0
fi
echo 'browser: wanted chromium, chromium-browser or google-chrome on PATH, found none; install it, for' \
    'example by "apt-get install chromium", or name one by ROSETTE_BROWSER' >&2
exit 1
