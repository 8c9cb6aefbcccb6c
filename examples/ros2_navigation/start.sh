#!/bin/sh
# Starts the nodes as one does by hand, in the background, until Ctrl-C.
# `. ./environment.sh` first.
cd "$(dirname "$0")" || exit 1
trap 'trap - TERM; kill 0; wait' INT TERM
for node in base localiser mapper costmap planner controller mission \
    camera detector speech recorder monitor; do
    python "nodes/$node.py" &
done
wait
