#include "ledger.h"

#include <sys/mman.h>
#include <sys/stat.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <system_error>

namespace poise {

// A line's number holds its index, so that whoever has the number finds it at once.
constexpr int index_bits = 16;
constexpr std::uint64_t index_mask = (1u << index_bits) - 1;

struct alignas(64) Pages::Head {
  Shared<std::uint64_t> used;
};

static std::system_error system_error(const char* what) {
  return std::system_error(errno, std::generic_category(), what);
}

std::uint64_t timer_releases(const Line& timer, double now) {
  const double releases = (now - timer.start.get()) / timer.period.get();
  return releases > 0.0 && releases < 1e15 ? static_cast<std::uint64_t>(releases) : 0;
}

Pages::Pages(int descriptor, bool writable) {
  struct stat found {};
  if (fstat(descriptor, &found) != 0) throw system_error("ledger");
  bytes_ = static_cast<std::size_t>(found.st_size);
  if (bytes_ < sizeof(Head) + sizeof(Line)) {
    errno = EINVAL;
    throw system_error("ledger is too small");
  }
  const int access = writable ? PROT_READ | PROT_WRITE : PROT_READ;
  void* memory = mmap(nullptr, bytes_, access, MAP_SHARED, descriptor, 0);
  if (memory == MAP_FAILED) throw system_error("ledger");
  head_ = static_cast<Head*>(memory);
  lines_ = reinterpret_cast<Line*>(head_ + 1);
  size_ = std::min((bytes_ - sizeof(Head)) / sizeof(Line),
                   static_cast<std::size_t>(index_mask));
}

Pages::~Pages() { munmap(head_, bytes_); }

Line* Pages::find(std::uint64_t id) const {
  const std::size_t index = id & index_mask;
  if (id == 0 || index >= size_ || lines_[index].id.get() != id) return nullptr;
  return &lines_[index];
}

std::size_t Pages::used() const {
  return std::min(static_cast<std::size_t>(head_->used.get()), size_);
}

void Pages::set_used(std::size_t used) { head_->used.set(used); }

Line* Ledger::take() {
  if (!free_.empty()) {
    Line* line = &pages_[free_.back()];
    free_.pop_back();
    return line;
  }
  if (used_ == pages_.size()) return nullptr;
  Line* line = &pages_[used_++];
  pages_.set_used(used_);
  return line;
}

std::uint64_t Ledger::show(Line& line) {
  const auto index = static_cast<std::uint64_t>(&line - &pages_[0]);
  line.id.set(++serial_ << index_bits | index);
  return line.id.get();
}

void Ledger::give_back(Line& line) {
  line.id.set(0);
  free_.push_back(static_cast<std::size_t>(&line - &pages_[0]));
}

bool Entered::enter(std::shared_ptr<Ledger> ledger, Kind kind, const std::string& name,
                    std::uint32_t epoch) {
  leave();
  Line* line = ledger->take();
  if (!line) return false;
  own_.kind.set(kind);
  own_.epoch.set(epoch);
  const std::size_t length = std::min(name.size(), Line::longest_name);
  std::memcpy(own_.name, name.data(), length);
  own_.name[length] = '\0';
  *line = own_;
  ledger->show(*line);
  ledger_ = std::move(ledger);
  line_ = line;
  return true;
}

void Entered::leave() {
  if (!ledger_) return;
  own_ = *line_;
  own_.id.set(0);
  ledger_->give_back(*line_);
  line_ = &own_;
  ledger_.reset();
}

}  // namespace poise
