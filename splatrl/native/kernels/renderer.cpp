namespace splatrl {
namespace SPLATRL_ISA {
}  // namespace SPLATRL_ISA
}  // namespace splatrl
