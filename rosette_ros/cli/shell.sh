# SPDX-License-Identifier: Apache-2.0
# What bash reads for `rosette shell`: the start-up file of the user, which may put other folders before ours.
[ -f ~/.bashrc ] && . ~/.bashrc
PATH="$ROSETTE_BIN:$PATH"
