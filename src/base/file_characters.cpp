#include "base/file_characters.h"

#include "base/files.h"
#include "base/interrupt.h"

namespace mirage {

FileCharacters::FileCharacters(const std::filesystem::path& file, std::uintmax_t most)
    : file_(file), most_(most), size_(file_.size()) {
  file_.check(size_, most_);
  fill();
  for (std::size_t mark = byte_order_mark({part_, held_}, file.string()); mark > 0; --mark) next();
}

void FileCharacters::fill() {
  throw_if_interrupted("what was finished is kept");
  before_ += held_;
  at_ = 0;
  held_ = file_.read(part_, sizeof part_);
  file_.check(before_ + held_, most_);
}

}  // namespace mirage
