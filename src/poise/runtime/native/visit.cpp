#include <Python.h>

#include "visit.h"

#include <mutex>
#include <unordered_map>

namespace poise {
namespace {

// Threads that end forget theirs without the GIL. Never destroyed: other threads may
// still run when the process ends.
struct Visits {
  std::mutex changing;
  std::unordered_map<Chain, std::weak_ptr<Visit>> by_chain;
};

Visits& visits() {
  static auto* all = new Visits();
  return *all;
}

// The last chain that began on this thread and went elsewhere from here. It stays this
// thread's, even when it is over: what comes back then is late.
thread_local std::shared_ptr<Visit> begun;

std::shared_ptr<Visit> find(Chain chain) {
  const std::lock_guard<std::mutex> lock(visits().changing);
  const auto place = visits().by_chain.find(chain);
  return place == visits().by_chain.end() ? nullptr : place->second.lock();
}

std::shared_ptr<Visit> begin(Chain chain) {
  auto visit = std::make_shared<Visit>(chain);
  const std::lock_guard<std::mutex> lock(visits().changing);
  visits().by_chain[chain] = visit;
  return visit;
}

}  // namespace

Visit::Visit(Chain chain) : chain_(chain), baton_("") { baton_.open(); }

Visit::~Visit() {
  const std::lock_guard<std::mutex> lock(visits().changing);
  const auto place = visits().by_chain.find(chain_);
  // unless the chain has come in again since the last thread let go of this one
  if (place != visits().by_chain.end() && place->second.expired())
    visits().by_chain.erase(place);
}

Entry Visit::take(double limit) {
  const Entry entry = baton_.enter(no_chain, limit);
  if (entry <= Entry::late) holder_ = PyThread_get_thread_ident();
  return entry;
}

void Visit::give() {
  holder_ = 0;
  baton_.leave();
}

std::shared_ptr<Visit> visit_of(Chain chain) {
  auto visit = find(chain);
  return visit ? visit : begin(chain);
}

Away::Away(Chain chain) {
  auto visit = find(chain);
  if (!visit) {
    visit_ = begun = begin(chain);
  } else if (visit->holder_ == PyThread_get_thread_ident()) {
    visit->give();
    visit_ = std::move(visit);
  } else if (visit == begun) {  // one that was called back has run too long
    visit_ = std::move(visit);
  }
}

}  // namespace poise
