#!/bin/sh
# Scan a part until its surface is known within a tolerance, and reconstruct it.
#
#     sh scan_until_tolerance.sh STATION.toml PLAN.toml NAME
#
# PLAN.toml has an [adaptive] table (docs/adaptive.md). The scan goes into NAME.scan, the result into
# NAME. Reconstruction asks for each slice beyond the coarse ones; without it the scan would go on by
# itself. Ctrl-C pauses the scan at the slice's border; the same line with --resume goes on.
set -eu

station=$1
plan=$2
name=$3
shift 3

loftscan reconstruct "$name.scan" --follow --out "$name" --overwrite --formats step,stl,ply &
reconstruction=$!

# Whatever becomes of the scan, reconstruction ends with it and makes a result of what is there.
code=0
loftscan scan "$station" "$plan" --out "$name.scan" "$@" || code=$?
wait "$reconstruction" || code=$?
exit "$code"
