// libFuzzer on one parser: MIRAGE_FUZZ=calibration fuzz CORPUS… (tests/fuzz/run.py does that for all).
// MIRAGE_FUZZ=seeds fuzz FOLDER writes the seeds to FOLDER/PARSER/NAME and ends.
#include "fuzz/parsers.h"

#include <spdlog/spdlog.h>

#include <algorithm>
#include <cstdio>
#include <cstdlib>
#include <exception>
#include <string>

#include "base/files.h"
#include "fuzz/repair.h"
#include "fuzz/seeds.h"

extern "C" std::size_t LLVMFuzzerMutate(std::uint8_t* bytes, std::size_t size, std::size_t most);

namespace {

using namespace mirage::fuzz;

const Parser* parser = nullptr;

}  // namespace

extern "C" int LLVMFuzzerInitialize(int* count, char*** arguments) {
  const char* given = std::getenv("MIRAGE_FUZZ");
  const std::string name = given ? given : "";
  spdlog::set_level(spdlog::level::off);
  try {
    if (name == "seeds" && *count == 2) {
      for (const Seed& seed : seeds())
        mirage::write_file(std::filesystem::path((*arguments)[1]) / seed.parser / seed.name, seed.bytes);
      std::exit(0);
    }
    parser = &parser_named(name);
  } catch (const std::exception& problem) {
    std::fprintf(stderr, "MIRAGE_FUZZ: %s\n", problem.what());
    std::exit(2);
  }
  return 0;
}

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* bytes, std::size_t size) {
  try {
    read_bytes(*parser, {reinterpret_cast<const char*>(bytes), size});
  } catch (const std::exception& problem) {
    std::fprintf(stderr, "FINDING in %s: %s\n", parser->name, problem.what());
    std::abort();
  }
  return 0;
}

extern "C" std::size_t LLVMFuzzerCustomMutator(std::uint8_t* bytes, std::size_t size, std::size_t most,
                                               unsigned seed) {
  const std::string name = parser->name;
  if (name != "png" && name != "gltf") return LLVMFuzzerMutate(bytes, size, most);
  std::string file(reinterpret_cast<const char*>(bytes), size);
  file = name == "png" ? mutate_png(std::move(file), most, seed, LLVMFuzzerMutate)
                       : mutate_glb(std::move(file), most, seed, LLVMFuzzerMutate);
  size = std::min(file.size(), most);
  std::copy_n(file.begin(), size, bytes);
  return size;
}
