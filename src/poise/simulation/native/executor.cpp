#include "executor.h"

#include <algorithm>
#include <limits>

#include "elementary.h"
#include "engine.h"

namespace poise::simulation {

constexpr double never = std::numeric_limits<double>::infinity();
constexpr double least_quantile = 1e-9;

static double draw_normal(Draws& draws) {
  return normal_quantile(std::max(least_quantile, draws.next()));
}

// Draw the work of one run: log-normally around its mean.
static double draw_work(const Handler& handler, Draws& draws) {
  if (handler.spread == 0.0) return handler.work;
  return handler.work * exponential(handler.spread * (draw_normal(draws) - handler.spread / 2));
}

// Draw for how long one run waits, if it does: log-normally around the median.
static double draw_wait(const Handler& handler, Draws& draws) {
  if (handler.waiting < 1.0 && draws.next() >= handler.waiting) return 0.0;
  if (handler.wait_spread == 0.0) return handler.wait;
  return handler.wait * exponential(handler.wait_spread * draw_normal(draws));
}

Executor::Executor(Container& container, ComponentKey key, Incarnation& who, const Model& model,
                   DataAges ages)
    : container_(container),
      engine_(container.engine()),
      key_(key),
      who_(who),
      model_(model),
      ages_(std::move(ages)),
      due_at_(never) {
  for (const TimerModel& each : model_.timers)
    timers_.declare(each.name, each.period, each.deadline);
}

double Executor::now() const { return engine_.events.now(); }

bool Executor::is_working() const {
  return is_active_ && is_wanted_ && !is_paused_ && may_work();
}

void Executor::activate() {
  is_active_ = true;
  if (is_paused_) return;
  timers_.start(now(), now() - model_.release_offset);
  plan();
}

void Executor::deactivate() {
  is_active_ = false;
  timers_.stop(now());
}

void Executor::pause() {
  if (!is_paused_ && is_active_) timers_.stop(now());
  is_paused_ = true;
}

void Executor::resume() {
  if (!is_paused_) return;
  is_paused_ = false;
  while_paused_ = waiting_;
  if (is_active_) activate();
}

void Executor::take(Item item) {
  ++asked_;
  if (item.kind == Item::Kind::message) {
    const Port port = port_of(item.connector->slot);
    std::size_t& waiting = waiting_[port.first];
    const bool is_full = !is_paused_ && waiting >= port.room + while_paused_[port.first];
    if (is_full && make_room(port, item)) return work();
    ++waiting;
  }
  mailbox_.push_back(std::move(item));
  work();
}

Port Executor::port_of(const Slot* slot) const {
  const auto found = model_.keep.find(slot);
  return found == model_.keep.end() ? Port{slot, model_.keep_other} : found->second;
}

bool Executor::make_room(const Port& port, Item& item) {
  Item* place = nullptr;
  for (Item& each : mailbox_) {
    if (each.kind != Item::Kind::message) continue;
    if (port_of(each.connector->slot).first != port.first) continue;
    if (place)
      *place = std::move(each);
    else
      engine_.ledger.drop(*each.connector->slot);
    place = &each;
  }
  if (place) *place = std::move(item);
  return place;
}

void Executor::drop_waiting() {
  if (!is_idle_ && engine_.runs(key_.component, this)) return;
  for (const Item& item : mailbox_)
    if (item.kind == Item::Kind::message) engine_.ledger.drop(*item.connector->slot);
}

ExecutorState Executor::hand_over() {
  ExecutorState state{{}, {}, ages_.held()};
  state.waiting.swap(mailbox_);
  waiting_.clear();
  for (const Timer& timer : timers_.all()) state.due[timer.name()] = timer.due();
  return state;
}

void Executor::take_back(const ExecutorState& state) {
  mailbox_.insert(mailbox_.begin(), state.waiting.begin(), state.waiting.end());
  for (const Item& item : state.waiting)
    if (item.kind == Item::Kind::message) ++waiting_[port_of(item.connector->slot).first];
}

void Executor::restore(const ExecutorState& state) {
  take_back(state);
  timers_.begin_at(state.due);
  ages_.restore(state.held);
}

void Executor::note_marker(const Connector& connector, std::uint64_t migration) {
  markers_[connector.name_number] = migration;
}

std::uint64_t Executor::marker(int connector) const {
  const auto found = markers_.find(connector);
  return found == markers_.end() ? 0 : found->second;
}

bool Executor::is_overtaken(const Connector& connector) {
  const int epoch = connector.source.epoch;
  int& latest = latest_.try_emplace(connector.name_number, epoch).first->second;
  latest = std::max(latest, epoch);
  return epoch < latest;
}

void Executor::forget_source(const Connector& connector) {
  const auto found = latest_.find(connector.name_number);
  if (found != latest_.end() && found->second == connector.source.epoch) latest_.erase(found);
}

void Executor::plan() {
  const double due = timers_.next_due();
  if (due == never || due == due_at_) return;
  due_at_ = due;
  engine_.events.at(due, [this, due] { container_.perform([this, due] { on_due(due); }); });
}

void Executor::on_due(double due) {
  if (due != due_at_) return;
  due_at_ = never;
  work();
  if (!is_busy_ && is_working()) plan();
}

void Executor::work() {
  if (is_busy_ || !is_working()) return;
  auto& timers = timers_.all();
  for (std::size_t i = 0; i < timers.size(); ++i)
    if (timers[i].due() <= now()) {
      ++asked_;
      begin_turn({&model_.timers[i].handler, &timers[i], {}, timers[i].begin(now()), now(), {}});
      return;
    }
  plan();
  if (mailbox_.empty()) return;
  Item item = std::move(mailbox_.front());
  mailbox_.pop_front();
  const bool is_call = item.kind == Item::Kind::call;
  auto& handlers = is_call ? model_.serves : model_.takes;
  if (item.kind == Item::Kind::message) {
    const Slot* const port = port_of(item.connector->slot).first;
    --waiting_[port];
    if (std::size_t& left = while_paused_[port]) --left;
  }
  const auto found = handlers.find(item.connector->slot);
  Handler* handler = found == handlers.end() ? &model_.other : &found->second;
  if (item.kind == Item::Kind::answer) handler = &*model_.answer;
  begin_turn({handler, nullptr, std::move(item), 0.0, now(), {}});
}

void Executor::begin_turn(Turn turn) {
  is_busy_ = true;
  turn_ = std::move(turn);
  engine_.ledger.begin(who_, now());
  ages_.begin();
  const Item& item = turn_.item;
  if (item.kind == Item::Kind::message && !turn_.timer)
    engine_.ledger.process(*item.connector->slot, item.number, who_);
  if (!item.stamps.empty()) ages_.take(item.connector->carries, item.stamps);
  for (Sender* sender : senders(turn_.handler->started)) sender->call(*this, 0);
  std::vector<Sender*> joined = senders(turn_.handler->joined);
  if (!joined.empty()) turn_.to_call.push_back(std::move(joined));
  const std::vector<Sender*> calls = senders(turn_.handler->calls);
  for (auto each = calls.rbegin(); each != calls.rend(); ++each) turn_.to_call.push_back({*each});
  call_next();
}

void Executor::call_next() {
  if (turn_.to_call.empty()) return begin_wait();
  const std::vector<Sender*> next = std::move(turn_.to_call.back());
  turn_.to_call.pop_back();
  const std::uint64_t before = call_;
  for (std::size_t i = 0; i < next.size(); ++i) open_.push_back(++call_);
  for (std::size_t i = 0; i < next.size(); ++i) next[i]->call(*this, before + 1 + i);
}

void Executor::end_call(std::uint64_t number, const Connector& over, const Stamps* answer) {
  const auto is_over = [this, number] {
    return number != 0 && std::find(open_.begin(), open_.end(), number) == open_.end();
  };
  if (is_over()) return;
  ++(answer ? engine_.ledger.calls : engine_.ledger.failed_calls);
  container_.perform([this, number, &over, is_over, stamps = answer ? *answer : Stamps{}] {
    if (is_over()) return;
    if (!stamps.empty()) ages_.take(over.answers, stamps);
    if (number != 0) {
      open_.erase(std::find(open_.begin(), open_.end(), number));
      if (open_.empty()) call_next();
    } else if (model_.answer && is_there()) {
      take({Item::Kind::answer, 0, {}, {}, &over});
    }
  });
}

void Executor::begin_wait() {
  const Handler& handler = *turn_.handler;
  const double wait = handler.waiting > 0.0 ? draw_wait(handler, engine_.draws) : 0.0;
  if (wait <= 0.0) return begin_work();
  engine_.events.at(now() + wait, [this] { container_.perform([this] { begin_work(); }); });
}

void Executor::begin_work() {
  const auto& factors = model_.factors;
  double work = draw_work(*turn_.handler, engine_.draws);
  if (!factors.empty()) work *= factors[static_cast<std::size_t>(now()) % factors.size()];
  if (!turn_.timer && turn_.item.kind != Item::Kind::answer)
    work += turn_.item.connector->target_cost;
  container_.group().run(work, [this] { finish_work(); }, &cpu_);
}

void Executor::finish_work() {
  engine_.ledger.end(who_, container_.awake_since(), now());
  if (may_work()) publish();
  ages_.end(turn_.timer || turn_.item.kind == Item::Kind::answer, now());
  if (turn_.timer) turn_.timer->end(turn_.release, turn_.began, now());
  end_turn();
}

void Executor::publish() {
  auto& publishes = turn_.handler->publishes;
  if (!publishes || !publishes->empty()) {
    engine_.ledger.act(who_, now());
    for (Sender* sender : publishes ? senders(*publishes) : container_.senders_of(key_))
      sender->publish(*this);
  }
  const Item& item = turn_.item;
  if (turn_.timer || item.kind != Item::Kind::call) return;
  const Call& call = item.call;
  Stamps stamps = ages_.stamps(item.connector->answers, now());
  const Connector& over = *item.connector;
  if (!call.back)
    call.caller->end_call(call.number, over, &stamps);
  else
    call.back->send(call.size, [caller = call.caller, number = call.number, &over,
                                stamps = std::move(stamps)] {
      caller->end_call(number, over, &stamps);
    });
}

void Executor::end_turn() {
  is_busy_ = false;
  ++done_;
  container_.note_progress();
  const std::int64_t missed = timers_.missed(now());
  if (missed > missed_) container_.note_missed();
  missed_ = std::max(missed, missed_);
  if (when_idle_) {
    engine_.events.tell(std::move(when_idle_));
    when_idle_ = nullptr;
  }
  work();
}

std::vector<Sender*> Executor::senders(std::vector<Output>& outputs) {
  std::vector<Sender*> found;
  for (Output& output : outputs) {
    output.credit += output.rate;
    const int times = static_cast<int>(output.credit);
    output.credit -= times;
    if (times == 0) continue;
    if (Sender* sender = container_.sender_of(*output.slot, key_.epoch))
      found.insert(found.end(), static_cast<std::size_t>(times), sender);
  }
  return found;
}

}  // namespace poise::simulation
