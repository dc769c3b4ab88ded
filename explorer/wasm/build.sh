#!/bin/sh
# Compiles the kernels to WebAssembly: wasm/build.sh FOLDER writes FOLDER/public/kernels.wasm. Sources are those of the
# library where they are short, and drivers over its headers for one trajectory. Exceptions are not caught: nothing throws
# but a failed allocation.
set -e
here=$(cd "$(dirname "$0")" && pwd)
source="$here/../../src/coadjoint/kernels/source"
out=$1
mkdir -p "$out/objects" "$out/public"
options="-std=c++17 -ffp-contract=off -fno-math-errno -msimd128 -DNDEBUG -Wno-psabi"
exported=_flow_advance,_runge_kutta_advance,_stepping_advance,_runge_kutta_advance_memory_size
exported=$exported,_stepping_advance_memory_size,_taylor_address,_isospectral_address,_product_address
exported=$exported,_description,_malloc,_free,_probe_fma,_probe_fma_of_pair
set --
for file in "$here"/*.cpp "$source/steps/series.cpp" "$source/steps/series_with_gradient.cpp" "$source/steps/stepping.cpp" \
    "$source/stages/newton.cpp" "$source/boundary/description.cpp" "$source/boundary/interrupts.cpp" \
    "$source/recording/watching.cpp" "$source/recording/crossings.cpp" "$source/field/field.cpp" \
    "$source/numbers/elementary.cpp"; do
    object="$out/objects/$(basename "$file" .cpp).o"
    case $file in */matrices.cpp) level=-O2 ;; *) level=-Os ;; esac  # products of matrices are five times faster
    emcc $options $level "-I$source" -include "$here/fused.hpp" -c "$file" -o "$object"
    set -- "$@" "$object"
done
emcc -Os -msimd128 --no-entry "$@" -o "$out/public/kernels.wasm" -s STANDALONE_WASM=1 -s ALLOW_MEMORY_GROWTH=1 \
    -s INITIAL_MEMORY=2MB -s TOTAL_STACK=256KB -s "EXPORTED_FUNCTIONS=$exported"
echo "kernels.wasm: $(wc -c < "$out/public/kernels.wasm") bytes, $(gzip -9c "$out/public/kernels.wasm" | wc -c) compressed"
