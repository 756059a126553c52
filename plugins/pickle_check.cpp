#include "pickle_check.h"

#include <algorithm>
#include <cstdint>
#include <map>
#include <memory>
#include <set>
#include <stdexcept>
#include <vector>

namespace mirage {
namespace {

constexpr int kDeepest = 64;  ///< levels of lists in lists and modules in modules
const std::map<std::string, std::size_t, std::less<>> kElementSizes = {
    {"FloatStorage", 4}, {"HalfStorage", 2},    {"DoubleStorage", 8}, {"LongStorage", 8},
    {"IntStorage", 4},   {"ShortStorage", 2},   {"CharStorage", 1},   {"ByteStorage", 1},
    {"BoolStorage", 1},  {"BFloat16Storage", 2}};

enum class Kind { nothing, truth, whole, real, text, tuple, list, dictionary, name, object, storage, tensor };

/// Functions that say what a list is of.
const std::map<std::string, Kind, std::less<>> kLists = {{"build_intlist", Kind::whole},
                                                         {"build_doublelist", Kind::real},
                                                         {"build_boollist", Kind::truth},
                                                         {"build_tensorlist", Kind::tensor}};

struct Value {
  Kind kind = Kind::nothing;
  std::int64_t number = 0;                    ///< of whole; elements of a storage
  std::string text;                           ///< of text and name ("module name")
  std::vector<std::shared_ptr<Value>> items;  ///< of tuple and list
  int depth = 0;
  bool held = false;  ///< in another value
};
using Reference = std::shared_ptr<Value>;

/// The stack machine of the format, on kinds instead of values.
class Walker {
 public:
  Walker(std::string_view bytes, const StorageSize& storage_size)
      : bytes_(bytes), storage_size_(storage_size) {}

  void walk() {
    demand(byte() == 0x80 && byte() == 2, "is not of protocol 2");
    while (true) {
      const int code = byte();
      if (code == '.') break;
      step(code);
    }
    demand(marks_.empty() && stack_.size() == 1 && at_ == bytes_.size(), "ends too early or too late");
  }

 private:
  static void demand(bool good, const char* problem) {
    if (!good) throw std::runtime_error(problem);
  }

  int byte() {
    demand(at_ < bytes_.size(), "is cut short");
    return static_cast<unsigned char>(bytes_[at_++]);
  }
  std::int64_t little_endian(int count, bool sign) {
    std::uint64_t value = 0;
    int last = 0;
    for (int i = 0; i < count; ++i) value |= static_cast<std::uint64_t>(last = byte()) << 8 * i;
    if (sign && count < 8 && count > 0 && last >= 128) value |= ~std::uint64_t{0} << 8 * count;
    return static_cast<std::int64_t>(value);
  }
  std::string text(std::size_t size) {
    demand(size <= bytes_.size() - at_, "is cut short");
    at_ += size;
    return std::string(bytes_.substr(at_ - size, size));
  }
  std::string line() {
    const std::size_t end = bytes_.find('\n', at_);
    demand(end != std::string_view::npos, "is cut short");
    std::string read = text(end - at_);
    ++at_;
    return read;
  }

  void push(Kind kind, std::int64_t number = 0, std::string said = "") {
    auto value = std::make_shared<Value>();
    value->kind = kind;
    value->number = number;
    value->text = std::move(said);
    stack_.push_back(std::move(value));
  }
  /// Not below the last mark.
  Reference pop() {
    demand(stack_.size() > (marks_.empty() ? 0 : marks_.back()), "takes more than it put");
    Reference value = std::move(stack_.back());
    stack_.pop_back();
    return value;
  }
  Reference pop(Kind kind, const char* problem) {
    Reference value = pop();
    demand(value->kind == kind, problem);
    return value;
  }
  std::vector<Reference> pop_to_mark() {
    demand(!marks_.empty(), "takes more than it put");
    std::vector<Reference> items(stack_.begin() + static_cast<std::ptrdiff_t>(marks_.back()), stack_.end());
    stack_.resize(marks_.back());
    marks_.pop_back();
    return items;
  }
  Value& top() {
    demand(stack_.size() > (marks_.empty() ? 0 : marks_.back()), "takes more than it put");
    return *stack_.back();
  }
  /// What is held gets nothing more: a list in itself, or in a list of itself, has no end.
  static void hold(Value& holder, Value& item) {
    demand(&holder != &item && !holder.held, "is nested without end");
    item.held = true;
    holder.depth = std::max(holder.depth, item.depth + 1);
    demand(holder.depth <= kDeepest, "is nested too deeply");
  }
  void put_pairs(const std::vector<Reference>& items) {
    demand(items.size() % 2 == 0, "names an attribute without a value");
    Value& dictionary = top();
    demand(dictionary.kind == Kind::dictionary, "puts an attribute into what has none");
    for (std::size_t i = 0; i < items.size(); i += 2) {
      demand(items[i]->kind == Kind::text || items[i]->kind == Kind::whole, "names an attribute by no text");
      hold(dictionary, *items[i + 1]);
    }
  }
  void put_items(const std::vector<Reference>& items) {
    Value& list = top();
    demand(list.kind == Kind::list, "puts an item into what is no list");
    for (const Reference& item : items) hold(list, *item);
    list.items.insert(list.items.end(), items.begin(), items.end());
  }

  void global() {
    const std::string module = line(), name = line();
    const bool own = (module == "__torch__" || module.starts_with("__torch__.")) && name == "Module";
    const bool known = (module == "collections" && name == "OrderedDict") ||
                       (module == "torch._utils" && name == "_rebuild_tensor_v2") ||
                       (module == "torch" && kElementSizes.contains(name)) ||
                       (module == "torch.jit._pickle" && kLists.contains(name));
    demand(own || known, "names something that weights do not need");
    push(Kind::name, own, module + " " + name);
  }

  /// ("storage", type, key, device, elements)
  void storage() {
    const Reference id = pop(Kind::tuple, "names a storage wrongly");
    const auto& part = id->items;
    demand(part.size() == 5 && part[0]->kind == Kind::text && part[0]->text == "storage" &&
               part[1]->kind == Kind::name && part[1]->text.starts_with("torch ") &&
               part[2]->kind == Kind::text && part[3]->kind == Kind::text && part[4]->kind == Kind::whole,
           "names a storage wrongly");
    demand(part[3]->text == "cpu" || part[3]->text.starts_with("cuda"), "names a storage's device wrongly");
    demand(storages_.insert(part[2]->text).second, "names a storage twice");
    const std::int64_t elements = part[4]->number;
    const auto size = storage_size_(part[2]->text);
    const std::size_t element = kElementSizes.at(part[1]->text.substr(6));
    demand(size && elements >= 0 && static_cast<std::uint64_t>(elements) <= *size / element,
           "has a storage with too few bytes");
    push(Kind::storage, elements);
  }

  void reduce() {
    const Reference arguments = pop(Kind::tuple, "calls without arguments");
    const Reference function = pop(Kind::name, "calls what is no function");
    if (function->text == "collections OrderedDict") {
      demand(arguments->items.empty(), "calls with wrong arguments");
      return push(Kind::dictionary);
    }
    if (function->text.starts_with("torch.jit._pickle ")) {
      demand(arguments->items.size() == 1 && arguments->items[0]->kind == Kind::list,
             "calls with wrong arguments");
      const Kind of = kLists.at(function->text.substr(18));
      for (const Reference& item : arguments->items[0]->items)
        demand(item->kind == of, "has a list of mixed items");
      return stack_.push_back(arguments->items[0]);
    }
    demand(function->text == "torch._utils _rebuild_tensor_v2", "calls what is no function");
    // (storage, offset, sizes, strides, requires_grad, hooks)
    const auto& part = arguments->items;
    demand(part.size() == 6 && part[0]->kind == Kind::storage && part[1]->kind == Kind::whole &&
               part[2]->kind == Kind::tuple && part[3]->kind == Kind::tuple && part[4]->kind == Kind::truth &&
               part[5]->kind == Kind::dictionary && part[2]->items.size() == part[3]->items.size() &&
               part[2]->items.size() <= 16,
           "makes a tensor wrongly");
    const std::int64_t elements = part[0]->number;
    std::int64_t last = part[1]->number;
    bool empty = false;
    demand(last >= 0 && last <= elements, "has a tensor beyond its storage");
    // A size of zero means that nothing is read; other sizes are bounded all the same, as is their product.
    std::int64_t count = 1;
    for (std::size_t i = 0; i < part[2]->items.size(); ++i) {
      const Value &size = *part[2]->items[i], &stride = *part[3]->items[i];
      demand(size.kind == Kind::whole && stride.kind == Kind::whole && size.number >= 0 &&
                 stride.number >= 0 && size.number <= elements &&
                 stride.number <= std::max<std::int64_t>(elements, 1),
             "has a tensor beyond its storage");
      empty = empty || size.number == 0;
      if (size.number == 0) continue;
      demand(count <= elements / size.number, "has a tensor beyond its storage");
      count *= size.number;
      demand(size.number == 1 || stride.number <= (elements - last) / (size.number - 1),
             "has a tensor beyond its storage");
      last += (size.number - 1) * stride.number;
    }
    demand(empty || last < elements, "has a tensor beyond its storage");
    push(Kind::tensor);
  }

  void step(int code) {
    switch (code) {
      case 'c':
        return global();
      case 'q':
        return remember(static_cast<std::uint64_t>(byte()));
      case 'r':
        return remember(static_cast<std::uint64_t>(little_endian(4, false)));
      case 'h':
        return recall(static_cast<std::uint64_t>(byte()));
      case 'j':
        return recall(static_cast<std::uint64_t>(little_endian(4, false)));
      case '(':
        return marks_.push_back(stack_.size());
      case ')':
        return push(Kind::tuple);
      case 't':
        return tuple(pop_to_mark());
      case 0x85:
      case 0x86:
      case 0x87:
        return tuple_of_last(code - 0x84);
      case '}':
        return push(Kind::dictionary);
      case ']':
        return push(Kind::list);
      case 'N':
        return push(Kind::nothing);
      case 0x88:
      case 0x89:
        return push(Kind::truth);
      case 'K':
        return push(Kind::whole, little_endian(1, false));
      case 'M':
        return push(Kind::whole, little_endian(2, false));
      case 'J':
        return push(Kind::whole, little_endian(4, true));
      case 0x8a:
        return long_number();
      case 'G':
        return little_endian(8, false), push(Kind::real);
      case 'X': {
        const std::int64_t size = little_endian(4, false);
        return push(Kind::text, 0, text(static_cast<std::size_t>(size)));
      }
      case 'Q':
        return storage();
      case 'R':
        return reduce();
      case 0x81:
        return new_object();
      case 'b':
        return build();
      case 's': {
        const Reference value = pop(), key = pop();
        return put_pairs({key, value});
      }
      case 'u':
        return put_pairs(pop_to_mark());
      case 'a':
        return put_items({pop()});
      case 'e':
        return put_items(pop_to_mark());
      default:
        throw std::runtime_error("has an instruction that weights do not need");
    }
  }

  void remember(std::uint64_t place) {
    // LibTorch numbers them in their order, and makes room for as many as the number says.
    demand(place <= memory_.size(), "remembers out of order");
    top();
    if (place == memory_.size())
      memory_.push_back(stack_.back());
    else
      memory_[place] = stack_.back();
  }
  void recall(std::uint64_t place) {
    demand(place < memory_.size(), "recalls what it never kept");
    stack_.push_back(memory_[place]);
  }
  void tuple_of_last(int count) {
    std::vector<Reference> items;
    for (int i = 0; i < count; ++i) items.insert(items.begin(), pop());
    tuple(std::move(items));
  }
  void tuple(std::vector<Reference> items) {
    auto value = std::make_shared<Value>();
    value->kind = Kind::tuple;
    value->items = std::move(items);
    for (const Reference& item : value->items) hold(*value, *item);
    stack_.push_back(std::move(value));
  }
  void long_number() {
    const int size = byte();
    demand(size <= 8, "has a number of too many bytes");
    push(Kind::whole, little_endian(size, true));
  }
  void new_object() {
    const Reference arguments = pop(Kind::tuple, "makes a module wrongly");
    const Reference type = pop(Kind::name, "makes a module wrongly");
    demand(arguments->items.empty() && type->number == 1, "makes a module wrongly");
    push(Kind::object);
  }
  void build() {
    const Reference state = pop(Kind::dictionary, "fills a module wrongly");
    Value& object = top();
    demand(object.kind == Kind::object, "fills a module wrongly");
    hold(object, *state);
  }

  std::string_view bytes_;
  const StorageSize& storage_size_;
  std::size_t at_ = 0;
  std::vector<Reference> stack_, memory_;
  std::vector<std::size_t> marks_;
  std::set<std::string> storages_;
};

}  // namespace

void check_pickle(std::string_view bytes, const StorageSize& storage_size) {
  Walker(bytes, storage_size).walk();
}

}  // namespace mirage
