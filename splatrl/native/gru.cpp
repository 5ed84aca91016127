#include "gru.h"

namespace splatrl {

const GruKernels& gru_kernels_of(Isa isa) {
    switch (isa) {
#ifdef SPLATRL_X86
        case Isa::avx512: return avx512::gru_kernels;
        case Isa::avx2: return avx2::gru_kernels;
#endif
        default: return portable::gru_kernels;
    }
}

}  // namespace splatrl
