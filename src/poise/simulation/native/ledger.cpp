#include "ledger.h"

#include <algorithm>
#include <cstdio>

namespace poise::simulation {

static std::string text(const Incarnation& who) {
  return "'" + who.component + "' (" + std::to_string(who.epoch) + ") on '" + who.computer + "'";
}

static std::string text(double moment) {
  char written[32];
  std::snprintf(written, sizeof written, "%.3f s", moment);
  return written;
}

static std::string has_worked(const Life& life) {
  return text(*life.current) + " has worked since " + text(life.since);
}

Incarnation& Ledger::incarnation(const std::string& component, int epoch,
                                 const std::string& computer, std::int64_t process) {
  const Incarnation who{component, epoch, computer, lives_[component]};
  return incarnations_.try_emplace({component, epoch, process}, who).first->second;
}

Slot& Ledger::slot(const std::string& name) {
  return slots_.try_emplace(name, Slot{name}).first->second;
}

void Ledger::begin(Incarnation& who, double now) {
  ++handled;
  Life& life = who.life;
  if (life.current == &who) return;
  if (who.epoch < life.committed)
    violate("committed-stays", text(who) + " began a handler at " + text(now) +
                                   ", but a move to incarnation " +
                                   std::to_string(life.committed) + " was committed");
  // where the newer one was killed before a client knew of it, the older may go on
  if (who.is_past && !life.current->is_dead) {
    violate("nothing-active-twice",
            text(who) + " began a handler at " + text(now) + ", but " + has_worked(life));
    return;
  }
  if (life.current) life.current->is_past = true;
  life.current = &who;
  who.is_past = false;
  life.since = now;
}

void Ledger::end(const Incarnation& who, double awake, double now) {
  const double since = who.life.since > awake ? who.life.since : awake;
  if (who.is_past && now - since > late_handler)
    violate("nothing-active-twice", "a handler of " + text(who) + " went on until " + text(now) +
                                        ", but " + has_worked(who.life));
}

void Ledger::act(const Incarnation& who, double now) {
  if (who.is_past)
    violate("nothing-active-twice",
            text(who) + " published at " + text(now) + ", but " + has_worked(who.life));
}

void Ledger::process(Slot& slot, std::uint64_t number, const Incarnation& who) {
  ++processed;
  const Slot::Run* before = nullptr;  // what the same component processed last
  bool is_repeated = false;
  for (const Slot::Run& run : slot.runs) {
    if (run.reader == &who.life) before = &run;
    is_repeated |= run.first <= number && number <= run.last;
  }
  if (is_repeated || (before && number < before->first))
    violate("each-message-once-in-order", text(who) + " processed message " +
                                              std::to_string(number) + " of '" + slot.name +
                                              "' after " + std::to_string(slot.last));
  if (before && before == &slot.runs.back())
    slot.runs.back().last = number;
  else
    slot.runs.push_back({&who.life, number, number});
  if (number <= slot.last) return;  // an alternative has processed later ones
  const std::uint64_t missing = number - slot.last - 1;
  if (is_whole && slot.last && missing > slot.dropped)
    violate("nothing-is-lost", text(who) + " processed message " + std::to_string(number) + " of '" +
                                   slot.name + "' after " + std::to_string(slot.last) +
                                   ", and nothing was broken");
  slot.dropped -= std::min(missing, slot.dropped);
  slot.last = number;
}

}  // namespace poise::simulation
