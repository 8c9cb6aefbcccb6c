#include "stats_page.h"

#include <sys/mman.h>
#include <sys/stat.h>

#include <algorithm>
#include <cerrno>
#include <system_error>

namespace poise {

// A record's id holds its index, so that it is found at once.
constexpr int index_bits = 16;
constexpr std::uint64_t index_mask = (1u << index_bits) - 1;

struct alignas(64) StatsMemory::Head {
  Shared<std::uint64_t> used;
  Shared<std::uint64_t> heartbeat;
  Shared<double> lease_end;
};

static std::system_error system_error(const char* what) {
  return std::system_error(errno, std::generic_category(), what);
}

std::uint64_t timer_releases(const Record& timer, double now) {
  const double releases = (now - timer.start.get()) / timer.period.get();
  return releases > 0.0 && releases < 1e15 ? static_cast<std::uint64_t>(releases) : 0;
}

StatsMemory::StatsMemory(int descriptor, bool writable) {
  struct stat found {};
  if (fstat(descriptor, &found) != 0) throw system_error("stats page");
  bytes_ = static_cast<std::size_t>(found.st_size);
  if (bytes_ < sizeof(Head) + sizeof(Record)) {
    errno = EINVAL;
    throw system_error("stats page is too small");
  }
  const int access = writable ? PROT_READ | PROT_WRITE : PROT_READ;
  void* memory = mmap(nullptr, bytes_, access, MAP_SHARED, descriptor, 0);
  if (memory == MAP_FAILED) throw system_error("stats page");
  head_ = static_cast<Head*>(memory);
  records_ = reinterpret_cast<Record*>(head_ + 1);
  size_ = std::min((bytes_ - sizeof(Head)) / sizeof(Record),
                   static_cast<std::size_t>(index_mask));
}

StatsMemory::~StatsMemory() { munmap(head_, bytes_); }

Record* StatsMemory::find(std::uint64_t id) const {
  const std::size_t index = id & index_mask;
  if (id == 0 || index >= size_ || records_[index].id.get() != id) return nullptr;
  return &records_[index];
}

bool StatsMemory::is_still(std::size_t index, std::uint64_t id) const {
  // the reads before must not happen after the id is read again
  std::atomic_thread_fence(std::memory_order_acquire);
  return records_[index].id.get() == id;
}

std::uint64_t StatsMemory::heartbeat() const { return head_->heartbeat.get(); }

void StatsMemory::beat() { head_->heartbeat.add(1); }

double StatsMemory::lease_end() const { return head_->lease_end.get(); }

void StatsMemory::set_lease_end(double at) { head_->lease_end.set(at); }

std::size_t StatsMemory::used() const {
  return std::min(static_cast<std::size_t>(head_->used.get()), size_);
}

void StatsMemory::set_used(std::size_t used) { head_->used.set(used); }

Record* StatsPage::take() {
  if (!free_.empty()) {
    Record* record = &memory_[free_.back()];
    free_.pop_back();
    return record;
  }
  if (used_ == memory_.size()) return nullptr;
  Record* record = &memory_[used_++];
  memory_.set_used(used_);
  return record;
}

std::uint64_t StatsPage::show(Record& record) {
  const auto index = static_cast<std::uint64_t>(&record - &memory_[0]);
  record.id.set(++serial_ << index_bits | index);
  return record.id.get();
}

void StatsPage::give_back(Record& record) {
  record.id.set(0);
  // what the next owner writes must not be seen before that
  std::atomic_thread_fence(std::memory_order_release);
  free_.push_back(static_cast<std::size_t>(&record - &memory_[0]));
}

bool Slot::enter(std::shared_ptr<StatsPage> page, Kind kind, const std::string& name,
                    std::uint32_t epoch) {
  leave();
  Record* record = page->take();
  if (!record) return false;
  own_.kind.set(kind);
  own_.epoch.set(epoch);
  own_.name.set(name);
  *record = own_;
  page->show(*record);
  page_ = std::move(page);
  record_ = record;
  return true;
}

void Slot::leave() {
  if (!page_) return;
  own_ = *record_;
  own_.id.set(0);
  page_->give_back(*record_);
  record_ = &own_;
  page_.reset();
}

}  // namespace poise
