#!/usr/bin/env bash
# Renders chunk number $1 of a path into $OUT; what runs on every engine of this folder. Exit codes are those of gs3: 75 is
# worth another try, 2 is not.
#
#   SCENE    scene file or folder, or demo
#   FRAMES   rendered frames of the whole path
#   OUT      folder of the frames, shared by all chunks
#   CHUNK    rendered frames of a chunk, a multiple of the 32 frames from keyframe to keyframe [32]
#   OPTIONS  more options of gs3 render, the same for all chunks
#   GS3      the command [gs3]
set -euo pipefail
index=$1
chunk=${CHUNK:-32}
# Chunks begin one frame after a keyframe: then that keyframe is all of a chunk's warm-up.
first=$((index == 0 ? 0 : index * chunk + 1))
end=$(((index + 1) * chunk + 1))
end=$((end < FRAMES ? end : FRAMES))
if [ "$first" -ge "$end" ]; then
  echo "chunk $index: expected a chunk below $(((FRAMES - 2) / chunk + 1)), as many as $FRAMES frames have" >&2
  exit 2
fi
# shellcheck disable=SC2086 # options are words
exec "${GS3:-gs3}" render "$SCENE" --frames "$first..$end" --skip-existing --out "$OUT" ${OPTIONS:-}
