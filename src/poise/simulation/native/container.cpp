#include "container.h"

#include <algorithm>

#include "engine.h"

namespace poise::simulation {

constexpr double weight = 100.0;

template <class T>
static void erase(std::vector<T*>& all, const T& one) {
  all.erase(std::remove(all.begin(), all.end(), &one), all.end());
}

Container::Container(Engine& engine, Cpu& cpu, int computer, Action on_progress, Action on_missed)
    : engine_(engine),
      group_(cpu.group(weight, 1.0, std::numeric_limits<double>::infinity())),
      computer_(computer),
      on_progress_(std::move(on_progress)),
      on_missed_(std::move(on_missed)),
      awake_since_(engine.events.now()) {}

void Container::pause(bool is_paused) {
  is_paused_ = is_paused;
  group_.pause(is_paused);
  if (is_paused) return;
  awake_since_ = engine_.events.now();
  std::vector<Action> late;
  late.swap(late_);
  for (const Action& act : late) perform(act);
}

void Container::end() {
  if (is_dead_) return;
  is_dead_ = true;
  group_.end();
  for (Sender* sender : senders_) sender->close();
  for (Executor& executor : all_executors_) {
    executor.when_idle_ = nullptr;
    executor.who_.is_dead = true;
  }
  for (Executor* executor : executors_) executor->drop_waiting();
  late_.clear();
  on_progress_ = on_missed_ = nullptr;
  awaits_progress_ = awaits_missed_ = false;
}

bool Container::may_work(bool is_leased) const {
  return !is_leased || engine_.events.now() < lease_end_;
}

Executor& Container::add(ComponentKey key, Incarnation& who, const Model& model, DataAges ages) {
  Executor& executor = all_executors_.emplace_back(*this, key, who, model, std::move(ages));
  executors_.push_back(&executor);
  return executor;
}

void Container::remove(Executor& executor) {
  erase(executors_, executor);
  executor.is_removed_ = true;
  executor.drop_waiting();
}

Executor* Container::find(ComponentKey key) const {
  for (Executor* executor : executors_)
    if (executor->key() == key) return executor;
  return nullptr;
}

bool Container::has(int component, const Executor* other_than) const {
  return std::any_of(executors_.begin(), executors_.end(), [=](const Executor* each) {
    return each->key().component == component && each != other_than;
  });
}

void Container::connect(const std::vector<const Connector*>& connectors) {
  auto before = std::move(connectors_);
  connectors_.clear();
  for (const Connector* each : connectors) {
    connectors_[each->key_number] = each;
    before.erase(each->key_number);
  }
  for (const auto& [key, gone] : before)
    if (Executor* target = find(gone->target)) target->forget_source(*gone);
}

Sender& Container::add_sender(const Connector& connector) {
  senders_.push_back(&all_senders_.emplace_back(*this, connector));
  return *senders_.back();
}

void Container::remove_sender(Sender& sender) {
  erase(senders_, sender);
  sender.close();
}

Sender* Container::sender_of(const Slot& slot, int epoch) const {
  for (Sender* sender : senders_) {
    const Connector& connector = sender->connector();
    if (connector.slot == &slot && connector.source.epoch == epoch) return sender;
  }
  return nullptr;
}

std::vector<Sender*> Container::senders_of(ComponentKey key) const {
  std::vector<Sender*> found;
  for (Sender* sender : senders_)
    if (sender->connector().source == key) found.push_back(sender);
  return found;
}

void Container::receive(Item item) {
  perform([this, item = std::move(item)] {
    const Connector& connector = *item.connector;
    Executor* const target = find(connector.target);
    if (!target || connectors_.count(connector.key_number) == 0) {
      // its connection is not there any more
      const bool moves = engine_.runs(connector.target.component, target);
      if (item.kind == Item::Kind::message && !moves && !(target && target->is_wanted()))
        engine_.ledger.drop(*connector.slot);
      return;
    }
    if (item.kind == Item::Kind::marker)
      target->note_marker(connector, item.number);
    else if (item.kind == Item::Kind::call || !target->is_overtaken(connector))
      target->take(item);
    note_progress();
  });
}

void Container::note_progress() {
  if (!awaits_progress_) return;
  awaits_progress_ = false;
  engine_.events.tell(on_progress_);
}

void Container::note_missed() {
  if (!awaits_missed_) return;
  awaits_missed_ = false;
  engine_.events.tell(on_missed_);
}

}  // namespace poise::simulation
