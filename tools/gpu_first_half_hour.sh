#!/bin/bash
# First checks and benchmarks on a GPU machine without internet access, using the folder that tools/gpu_kit.sh packed.
#
#   tools/gpu_first_half_hour.sh [--kit .gpu_kit] [--out FOLDER] [--seconds 570] [--dry-run] [PART ...]
#
# --kit      folder that tools/gpu_kit.sh packed
# --out      folder for log.txt, steps.txt (how each step ended) and results; default $OUT, or .gpu_out
# --seconds  time limit for each part; steps that do not fit in are skipped and reported
# --dry-run  emulate the GPU, at tiny sizes; needs a C++ compiler
#
# Parts, all by default, in this order:
#   correct    load kernels, in the main thread and in another; compare frames with the CPU's, and a repeated run byte
#              for byte; compute-sanitizer; GPU tests of the renderer and the collision checker
#   learning   GPU tests of envs, training and the fit of captures
#   rendering  benchmark of the renderer, and its kernels in the profiler ncu
#   rest       the other sections of the benchmark
#
# Nothing is installed outside $WORK, which is splatrl-gpu-kit in the folder for temporary files by default. Each step
# is a process with a time limit, and a failing step does not stop the others. $PYTHON is the interpreter with PyTorch.
set -uo pipefail

PARTS=(correct learning rendering rest)
PYTHON=${PYTHON:-python3}
WORK=${WORK:-${TMPDIR:-/tmp}/splatrl-gpu-kit}

die() {
    echo "gpu_first_half_hour: $*" >&2
    exit 1
}

usage() {
    sed -n '2,/^set/{/^#/s/^# \{0,1\}//p}' "$0"
}

say() {
    printf '%s\n' "$@" | tee -a "$log"
}

# Records in one line how a step ended.
ended() { # NAME ENDING
    printf '%-40s  %s\n' "$1" "$2" >>"$steps"
    say "-- $1: $2"
}

# Runs a command within its time limit and that of the part. Its output goes to the log; the last lines are shown.
step() { # NAME SECONDS COMMAND...
    local name=$1 seconds=$2 left=$((deadline - SECONDS)) began=$SECONDS from status
    shift 2
    say "" "== $name: $*"
    if ((left < 6)); then
        ended "$name" "no time left"
        return
    fi
    ((seconds < left - 5)) || seconds=$((left - 5))
    from=$(stat -c %s "$log")
    { timeout -k 5 "$seconds" "$@" >>"$log" 2>&1 </dev/null; } 2>/dev/null # hides bash's message about a kill
    status=$?
    tail -c "+$((from + 1))" "$log" | tail -n "$SHOWN"
    case $status in
        0) ended "$name" "ok, $((SECONDS - began)) s" ;;
        124 | 137) ended "$name" "killed after $((SECONDS - began)) s" ;;
        *) ended "$name" "failed with status $status, $((SECONDS - began)) s" ;;
    esac
}
SHOWN=15

# Like step, but only if there is a GPU.
gpu_step() {
    if [[ -n $gpu || -n ${dry[*]} ]]; then step "$@"; else ended "$1" "no GPU, not run"; fi
}

# Like gpu_step, but only if a tool is installed as well.
tool_step() { # TOOL NAME SECONDS COMMAND...
    local tool=$1
    shift
    if command -v "$tool" >/dev/null; then gpu_step "$@"; else ended "$1" "no $tool, not run"; fi
}

# Installs the kit's wheels once, and copies the checkout's own Python and CUDA sources over them.
unpack() {
    local mark
    [[ -d $kit/wheels ]] || die "$kit: expected a folder packed by tools/gpu_kit.sh"
    mark=$(cat "$kit"/wheels/*.whl | sha256sum)
    if [[ $(cat "$WORK/mark" 2>/dev/null) != "$mark" ]]; then
        rm -rf "$WORK/site" "$WORK/mark"
        mkdir -p "$WORK"
        "$PYTHON" -m pip install -q --no-index --no-deps --no-compile --no-cache-dir --disable-pip-version-check \
            --target "$WORK/site" "$kit"/wheels/*.whl >>"$log" 2>&1 || die "the wheels were not installed: $(tail -n 3 "$log")"
        echo "$mark" >"$WORK/mark"
    fi
    cp -r splatrl/. "$WORK/site/splatrl/" && cp -r conf/. "$WORK/site/splatrl/conf/"
    sha256sum --check --quiet "$kit/sources.sha256" >>"$log" 2>&1 ||
        say "the C++ sources here differ from those in the wheel: pack the kit again, and do not trust the results below"
    mkdir -p "$WORK/cache"
    [[ ! -f $kit/kernels.tar.gz ]] || tar -xzf "$kit/kernels.tar.gz" -C "$WORK/cache"
}

# Runs the GPU tests in some folders, one process per file and all in parallel, since they use the GPU only for a small
# part of their time. The test of gsplat compiles it, if nvcc is there, so that the benchmark finds it compiled.
tests_in() { # FOLDER...
    local file files name running=()
    mapfile -t files < <(grep -rlE 'mark\.gpu' "$@" --include='test_*.py' | LC_ALL=C sort)
    for file in "${files[@]}"; do
        name=$WORK/${file//\//-}
        (
            log=$name.log steps=$name.steps
            : >"$log"
            : >"$steps"
            PYTHONSAFEPATH=1 gpu_step "$file" 150 "$PYTHON" -m pytest -o addopts= -p no:cacheprovider \
                --import-mode=append -q -x -m gpu "$file" >/dev/null
        ) &
        running+=($!)
    done
    wait "${running[@]}"
    for file in "${files[@]}"; do
        name=$WORK/${file//\//-}
        tee -a "$log" <"$name.log" | tail -n "$SHOWN"
        cat "$name.steps" >>"$steps"
    done
}

try() { # STEP SECONDS
    gpu_step "$1" "$2" "$PYTHON" benchmarks/gpu_steps.py "$1" "${dry[@]}"
}

part_correct() {
    try load 90
    try thread 60
    try tiny 60
    try frames 60
    try twice 60
    local tool quiet=(--report-api-errors no) # cuda-bindings looks up functions that only newer drivers have
    for tool in memcheck racecheck synccheck; do
        tool_step compute-sanitizer "$tool" 100 env PYTORCH_NO_CUDA_MEMORY_CACHING=1 \
            compute-sanitizer --tool "$tool" "${quiet[@]}" --error-exitcode 9 "$PYTHON" benchmarks/gpu_steps.py tiny
    done
    tests_in tests/renderers tests/native tests/collision
}

part_learning() {
    tests_in tests/envs tests/training tests/capture
}

benchmark() { # FOLDER SECONDS SECTION...
    local folder=$1 seconds=$2
    shift 2
    gpu_step "benchmark: $folder" "$seconds" "$PYTHON" benchmarks/gpu.py "${dry[@]}" \
        --folder "$out/$folder" --commit "$commit" --only "$@"
}

part_rendering() {
    benchmark rendering 200 rendering
    profile exact 0
    profile detail 0.5
}

profile() { # NAME TOLERANCE
    local report=$out/$1.ncu-rep
    rm -f "$report"
    tool_step ncu "profile: $1" 120 ncu --set full --clock-control none \
        --kernel-name regex:^draw --launch-skip 1 --launch-count 1 --export "$report" \
        "$PYTHON" benchmarks/gpu_steps.py launch --tolerance "$2" "${dry[@]}"
    [[ -f $report ]] || return
    step "report: $1" 30 ncu --import "$report" --page details
    ncu --import "$report" --page source --csv --print-source cuda,sass >"$out/$1.csv" 2>>"$log"
    step "stalls: $1" 30 "$PYTHON" benchmarks/gpu_stalls.py "$out/$1.csv"
}

part_rest() {
    benchmark rest 400 "first use" collision stepping training fit gsplat
}

kit=.gpu_kit out=${OUT:-.gpu_out} seconds=570 dry=() parts=()
while (($#)); do
    case $1 in
        --kit | --out | --seconds)
            (($# > 1)) || die "$1: expected a value"
            declare "${1#--}=$2"
            shift
            ;;
        --dry-run) dry=(--dry-run) ;;
        -h | --help)
            usage
            exit
            ;;
        -*) die "$1: expected one of --kit, --out, --seconds, --dry-run" ;;
        *)
            [[ " ${PARTS[*]} " == *" $1 "* ]] || die "$1: expected one of ${PARTS[*]}"
            parts+=("$1")
            ;;
    esac
    shift
done
((${#parts[@]})) || parts=("${PARTS[@]}")
[[ $seconds =~ ^[0-9]+$ ]] || die "--seconds $seconds: expected a number"
[[ $kit == /* ]] || kit=$PWD/$kit
[[ $out == /* ]] || out=$PWD/$out
cd "$(dirname "$0")/.." || exit
mkdir -p "$out"
log=$out/log.txt steps=$out/steps.txt deadline=$seconds
: >"$log"
: >"$steps"

unpack
commit=$(cat "$kit/commit" 2>/dev/null || echo unknown)
PATH=$PATH:/usr/local/cuda/bin
export PYTHONPATH=$WORK/site:$PWD PYTHONUNBUFFERED=1 PYTEST_DISABLE_PLUGIN_AUTOLOAD=1
export SPLATRL_CACHE=$WORK/cache SPLATRL_SCENES=$kit/scenes TORCH_EXTENSIONS_DIR=$WORK/extensions
gpu=$("$PYTHON" -c 'import torch as t; print(t.cuda.get_device_name() if t.cuda.is_available() else "")' 2>>"$log")
arch=$("$PYTHON" -c 'import torch as t; print("sm_%d%d" % t.cuda.get_device_capability() if t.cuda.is_available() else "sm_90")' 2>>"$log")
say "${gpu:-no GPU: steps that need one are not run${dry:+, but emulated}}; $commit"
step versions 60 "$PYTHON" benchmarks/gpu_kernels.py --count --arch "$arch"
for part in "${parts[@]}"; do
    "part_$part"
    deadline=$((SECONDS + seconds))
done
say "" "$(cat "$steps")"
! grep -qvE ' (ok, [0-9]+ s|no (compute-sanitizer|ncu), not run)$' "$steps"
