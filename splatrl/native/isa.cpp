#include "isa.h"

#include <cstdlib>
#include <stdexcept>

namespace splatrl {

const char* isa_name(Isa isa) {
    switch (isa) {
        case Isa::avx512: return "avx512";
        case Isa::avx2: return "avx2";
        case Isa::portable: return "portable";
    }
    throw std::logic_error("isa_name: unknown instruction set");
}

std::vector<Isa> supported_isas() {
    std::vector<Isa> isas{Isa::portable};
#ifdef SPLATRL_X86
    __builtin_cpu_init();
    if (__builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma")) isas.push_back(Isa::avx2);
    if (__builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512dq") &&
        __builtin_cpu_supports("avx512bw") && __builtin_cpu_supports("avx512vl"))
        isas.push_back(Isa::avx512);
#endif
    return isas;
}

Isa choose_isa() {
    const std::vector<Isa> isas = supported_isas();
    const char* forced = std::getenv("SPLATRL_ISA");
    if (forced == nullptr || *forced == '\0') return isas.back();
    std::string choices;
    for (Isa isa : isas) {
        if (forced == std::string(isa_name(isa))) return isa;
        choices += (choices.empty() ? "" : ", ") + std::string(isa_name(isa));
    }
    throw std::invalid_argument("SPLATRL_ISA: expected one of " + choices + " on this processor, got " + forced);
}

}  // namespace splatrl
