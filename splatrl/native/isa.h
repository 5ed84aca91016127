// The instruction sets that the kernels are compiled for.
#pragma once

#include <string>
#include <vector>

namespace splatrl {

enum class Isa { portable, avx2, avx512 };

const char* isa_name(Isa isa);

// The sets that this processor can run, slowest first.
std::vector<Isa> supported_isas();

// The fastest supported set, or the one that the environment variable SPLATRL_ISA names.
// Throws std::invalid_argument if that set is unknown or not supported.
Isa choose_isa();

}  // namespace splatrl
