#!/bin/bash
# Packs what a GPU machine without internet access lacks into one folder, to be copied there with the checkout.
#
#   tools/gpu_kit.sh [--python 3.12] [--arch sm_90] [--folder .gpu_kit] [--limit 64] [PART ...]
#
# --python  Python of that machine: a version, or the path of a matching interpreter on this one, which builds the wheel
# --arch    architecture of its GPU
# --folder  where to pack it
# --limit   maximum total size of folder and checkout, MiB
#
# Parts, all by default: project (the wheel of splatrl), packages (wheels that an image with PyTorch lacks), kernels
# (compiled for the GPU), kitchen (the captured scene), check (print sizes, and fail if anything is missing). project,
# packages and kernels need a package index; kernels also needs the extra cuda in the Python that is active here.
set -euo pipefail

# Besides PyTorch and its dependencies, NumPy, SciPy, Matplotlib, Pillow and tqdm are assumed to be installed there.
# PyAV is left out: it is large, and only videos need it. gsplat is for comparison, if nvcc is there to compile it.
PACKAGES=(
    torchrl tensordict hoptorch lazy-importer pyvers orjson importlib_metadata zipp cloudpickle packaging
    gymnasium farama-notifications hydra-core omegaconf antlr4-python3-runtime pyyaml plyfile python-fcl
    cuda-core cuda-bindings cuda-pathfinder
    pytest pluggy iniconfig pygments hypothesis sortedcontainers
    gsplat jaxtyping wadler-lindig rich markdown-it-py mdurl ninja
)
PARTS=(project packages kernels kitchen check)

die() {
    echo "gpu_kit: $*" >&2
    exit 1
}

usage() {
    sed -n '2,/^set/{/^#/s/^# \{0,1\}//p}' "$0"
}

# Lists the sources of the wheel's compiled part; Python and CUDA sources are copied from the checkout when installed.
cpp_sources() {
    find CMakeLists.txt splatrl/native -path splatrl/native/cuda -prune -o -type f \
        \( -name '*.cpp' -o -name '*.h' -o -name CMakeLists.txt \) -print | LC_ALL=C sort
}

# Sets `interpreter` to the Python that builds the wheel, and `version` to its version.
find_interpreter() {
    interpreter=$python
    [[ $python == */* ]] || interpreter=python$python
    version=$("$interpreter" -c 'import sys; print("%d.%d" % sys.version_info[:2])' 2>/dev/null) ||
        die "--python $python: found no working interpreter; give the path of one, such as \$(uv python find $python)"
    [[ $python == */* || $version == "$python" ]] || die "--python $python: $interpreter is $version"
}

pack_project() {
    local wheel=("$folder"/wheels/splatrl-*-"cp${version/./}"-*.whl)
    if [[ -f ${wheel[0]} ]] && sha256sum --check --status "$folder/sources.sha256" 2>/dev/null; then
        return # the C++ has not changed
    fi
    rm -f "$folder"/wheels/splatrl-*.whl
    "$interpreter" -m pip wheel -q --no-deps -w "$folder/wheels" . || die "project: the wheel was not built, see above"
    cpp_sources | xargs sha256sum >"$folder/sources.sha256"
}

pack_packages() {
    find "$folder/wheels" -name '*.whl' -not -name 'splatrl-*' -delete
    "$interpreter" -m pip wheel -q --no-deps -c constraints.txt -w "$folder/wheels" "${PACKAGES[@]}" ||
        die "packages: a wheel was not found or not built, see above"
}

pack_kernels() {
    python benchmarks/gpu_kernels.py --arch "$arch" --archive "$folder/kernels.tar.gz" ||
        die "kernels: not compiled, see above; the active Python needs: pip install -e '.[cuda]'"
}

pack_kitchen() {
    local scene=${SPLATRL_SCENES:-../shared/scenes}/kitchen/kitchen.spz
    if [[ -f $scene ]]; then
        install -D -m 644 "$scene" "$folder/scenes/kitchen/kitchen.spz"
    else
        echo "kitchen: left out, found no $scene; set SPLATRL_SCENES to the folder of scenes"
    fi
}

mib() {
    awk -v bytes="$1" 'BEGIN { printf "%6.1f MiB", bytes / 1048576 }'
}

pack_check() {
    local name pattern found kit=0 checkout
    for name in splatrl "${PACKAGES[@]}"; do
        pattern=${name//[-_.]/[-_.]}
        found=$(find "$folder/wheels" -iname "$pattern-*.whl" 2>/dev/null | wc -l)
        ((found == 1)) || die "$name: expected one wheel in $folder/wheels, found $found"
    done
    [[ -f $folder/kernels.tar.gz ]] || die "kernels: expected $folder/kernels.tar.gz"
    while read -r size file; do
        kit=$((kit + size))
        echo "$(mib "$size")  ${file##*/}"
    done < <(find "$folder" -type f -printf '%s %p\n' | sort -rn)
    checkout=$({ git ls-files -z | xargs -0r stat -c %s || true; } 2>/dev/null | awk '{ sum += $1 } END { print sum + 0 }')
    echo "$(mib $kit)  in $folder, $(mib $((kit + checkout)) | xargs) with the checkout"
    ((kit + checkout <= limit * 1048576)) ||
        die "$folder: expected at most $limit MiB with the checkout, got $(mib $((kit + checkout)) | xargs)"
}

python=3.12 arch=sm_90 folder=.gpu_kit limit=64 parts=()
while (($#)); do
    case $1 in
        --python | --arch | --folder | --limit)
            (($# > 1)) || die "$1: expected a value"
            declare "${1#--}=$2"
            shift
            ;;
        -h | --help)
            usage
            exit
            ;;
        -*) die "$1: expected one of --python, --arch, --folder, --limit" ;;
        *)
            [[ " ${PARTS[*]} " == *" $1 "* ]] || die "$1: expected one of ${PARTS[*]}"
            parts+=("$1")
            ;;
    esac
    shift
done
[[ $arch =~ ^sm_[0-9]+$ ]] || die "--arch $arch: expected an architecture such as sm_90"
[[ $limit =~ ^[0-9]+$ ]] || die "--limit $limit: expected a number of MiB"
((${#parts[@]})) || parts=("${PARTS[@]}")
[[ $folder == /* ]] || folder=$PWD/$folder
cd "$(dirname "$0")/.."
mkdir -p "$folder/wheels"
git describe --always --abbrev=40 --dirty=-changed --exclude='*' >"$folder/commit" 2>/dev/null || echo unknown >"$folder/commit"
[[ ! " ${parts[*]} " =~ " project "|" packages " ]] || find_interpreter
for part in "${parts[@]}"; do
    "pack_$part"
done
