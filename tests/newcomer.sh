#!/usr/bin/env bash
# A newcomer's first minutes: a fresh clone, an empty home, the commands of the README and nothing else, then a mesh of their own.
#
#   tests/newcomer.sh [COMMIT]
#
# Kernels that an earlier run has compiled are used if XDG_CACHE_HOME names their cache; otherwise all is compiled in the empty home.
set -euo pipefail
checkout=$(cd "$(dirname "$0")/.." && pwd)
commit=${1:-HEAD}
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

mkdir "$work/home"
export HOME=$work/home
unset NPTRACE_SCENES VIRTUAL_ENV PYTHONPATH

if commit=$(git -C "$checkout" rev-parse --quiet --verify "$commit^{commit}"); then
    git clone --quiet --no-hardlinks "$checkout" "$work/nptrace"
    cd "$work/nptrace"
    git checkout --quiet "$commit"
else # no repository, as in an unpacked sdist: its files, without what was made there
    mkdir "$work/nptrace"
    tar -C "$checkout" --exclude='./.venv*' --exclude='./build' --exclude='./traces/*/' -cf - . | tar -C "$work/nptrace" -xf -
    cd "$work/nptrace"
    git init --quiet && git add --all && git -c user.name=x -c user.email=x@example.com commit --quiet -m x
fi

# The blocks of the README, in its order and in one shell, as they are pasted.
awk '/^```/ { inside = ($0 == "```sh"); next } inside' README.md > "$work/readme.sh"
test "$(grep -c . "$work/readme.sh")" -ge 5
cat "$work/readme.sh"

cat > "$work/own.sh" <<'COMMANDS'
cat > table.obj <<'END'
v -3 0 -3
v  3 0 -3
v  3 0  3
v -3 0  3
v -1 1 -1
v  1 1 -1
v  1 1  1
v -1 1  1
f 1 4 3 2
f 5 8 7 6
END
nptrace render table.obj --pixels 32x32
npcache replay traces/table-kdtree-32x32 traces/table-bvh-32x32 --size 1K --assoc 2 --json > rates.json
COMMANDS

bash -euo pipefail -c "source '$work/readme.sh'; source '$work/own.sh'"

# What is there now: four runs, a picture, rates that are rates.
for run in court-standin-kdtree court-standin-bvh table-kdtree-32x32 table-bvh-32x32; do
    test -s "traces/$run/accesses.parquet"
done
test -s court-standin-bvh-accesses.png
python3 - <<'CHECK'
import json

rows = json.load(open("rates.json"))
assert [row["tree"] for row in rows] == ["kdtree", "bvh"], rows
assert all(0 < row["demand_miss_rate"] < 1 for row in rows), rows
CHECK

# The report page of a scene that is built in, as both trees, in a browser if there is one.
report() {
    . nptrace-env/bin/activate
    nptrace render room --pixels 32x32
    npcache report traces/room-standin-kdtree-32x32 traces/room-standin-bvh-32x32 -o room.html
    python tests/browser.py room.html
}
(report)
grep -q '<h1>Node caches: room</h1>' room.html

# Nothing was left behind that git would show, but for what the commands say that they write.
git status --porcelain | grep -v '^?? \(nptrace-env/\|table.obj\|rates.json\|room.html\|.*\.png\)' && exit 1
echo "newcomer: the README's commands and an own mesh work in a fresh clone, in $SECONDS s"
