#!/usr/bin/env bash
# What a user does first, with whatever versions are on the PATH: frames of a scene, images by a network, a look at them.
set -euo pipefail
out=$1
cd "$(dirname "$0")/.."
python --version
datafactory doctor
datafactory render --scene scenes/tiny.usda --frames 3 --points 5 --split 1:1:1 --rays 5000 --out "$out/data"
datafactory inspect "$out/data" --verify --frames 1
trainer predict "$out/data" --pretrained sparse6 --points --out "$out/images"
trainer fit "$out/data" --steps 2 --out "$out/run"
trainer evaluate "$out/data" --methods das,iaa --arrays sparse6 --experiments street,detection --out "$out/report"
echo "compatible"
