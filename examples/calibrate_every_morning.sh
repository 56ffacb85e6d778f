#!/bin/sh
# Look every morning whether the station still stands as it was calibrated.
#
#     sh calibrate_every_morning.sh STATION.toml ARTEFACT.toml PLAN.toml FOLDER
#
# The artefact is on the table; PLAN.toml is a short scan of it. FOLDER gets a report a day, with
# trend.png over all days. Exit code 0: the station may be used; 1: it has drifted beyond
# drift_limit_mm of ARTEFACT.toml, calibrate it anew (leave --check out); others: it did not run.
# For cron:  30 6 * * 1-5  sh calibrate_every_morning.sh ... || mail -s "the station has drifted" ...
set -eu

station=$1
artefact=$2
plan=$3
folder=$4/$(date +%Y-%m-%d)

mkdir -p "$4"
loftscan calibrate "$station" "$artefact" --plan "$plan" --check --report "$folder"
