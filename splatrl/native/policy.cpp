#include "policy.h"

namespace splatrl {

const PolicyKernels& policy_kernels_of(Isa isa) {
    switch (isa) {
#ifdef SPLATRL_X86
        case Isa::avx512: return avx512::policy_kernels;
        case Isa::avx2: return avx2::policy_kernels;
#endif
        default: return portable::policy_kernels;
    }
}

}  // namespace splatrl
