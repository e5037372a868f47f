#!/bin/sh
# Measures gs3 on this machine's GPU: report.json, report.md. Arguments: ./xtask measure --help.
set -eu
cd "$(dirname "$0")"
for program in ./xtask ./gs3; do
  if ! said=$("$program" --help 2>&1); then
    case $said in
      # What the C library says that is too old; where there is another one, the shell does not find the program.
      *GLIBC_* | *"not found"*)
        echo "run.sh: $program needs @GLIBC@ or newer; this machine has $(getconf GNU_LIBC_VERSION 2>/dev/null || echo none)" ;;
      *) echo "run.sh: $program does not start: $said" ;;
    esac >&2
    exit 1
  fi
done
exec ./xtask measure "$@"
