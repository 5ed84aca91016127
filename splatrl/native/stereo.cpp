#include "stereo.h"

namespace splatrl {

const StereoKernels& stereo_kernels_of(Isa isa) {
    switch (isa) {
#ifdef SPLATRL_X86
        case Isa::avx512: return avx512::stereo_kernels;
        case Isa::avx2: return avx2::stereo_kernels;
#endif
        default: return portable::stereo_kernels;
    }
}

}  // namespace splatrl
