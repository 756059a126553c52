// Which BLAS a program with Ceres in it has: LibTorch multiplies by whatever its process finds first.
#include <dlfcn.h>
#include <gtest/gtest.h>

#include <string>

namespace {

/// The library that holds what this process finds under a name.
std::string library_of(const char* symbol) {
  Dl_info info{};
  void* found = dlsym(RTLD_DEFAULT, symbol);
  return found && dladdr(found, &info) && info.dli_fname ? info.dli_fname : "";
}

TEST(Blas, IsOpenBlasAndNotTheAtlasThatCeresBrings) {
  if (!dlopen("libopenblas.so.0", RTLD_LAZY | RTLD_LOCAL)) GTEST_SKIP() << "no OpenBLAS on this machine";
  for (const char* routine : {"sgemm_", "dgemm_", "sgemv_", "ssyrk_"})
    EXPECT_NE(library_of(routine).find("openblas"), std::string::npos)
        << routine << " is that of " << library_of(routine);
}

}  // namespace
