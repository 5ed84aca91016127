#include "trunk.h"

namespace splatrl {

const TrunkKernels& trunk_kernels_of(Isa isa) {
    switch (isa) {
#ifdef SPLATRL_X86
        case Isa::avx512: return avx512::trunk_kernels;
        case Isa::avx2: return avx2::trunk_kernels;
#endif
        default: return portable::trunk_kernels;
    }
}

}  // namespace splatrl
