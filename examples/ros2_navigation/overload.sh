#!/bin/sh
# Starts all nodes on `main`, with a detector that looks three times as thoroughly as
# when it was measured, and prints how regularly the controller works: once as it is,
# and once with Poise adapting.
cd "$(dirname "$0")" || exit 1
. ./environment.sh
command -v poise >/dev/null || { echo "no poise on PATH: . .venv/bin/activate" >&2; exit 1; }
sed 's|nodes/detector.py|&, params: {scales: 12}|' robot.yaml >overloaded.yaml
for adapt in "" --adapt; do
    echo "all on main, ${adapt:-nobody adapts}:"
    poise run overloaded.yaml --task work --placement all-on-main.yaml $adapt \
        --for 50s --allow-errors 2>&1 | grep --line-buffered -E "^controller .* Hz|machine was too busy"
done

rm -f overloaded.yaml
