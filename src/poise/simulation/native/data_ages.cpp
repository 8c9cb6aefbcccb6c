#include "data_ages.h"

#include <algorithm>
#include <cmath>

namespace poise::simulation {

constexpr double unknown = std::numeric_limits<double>::quiet_NaN();

void ChainAge::take(double stamp) {
  if (!is_new)
    held = stamp;
  else if (!std::isnan(held))  // one that is not known makes the run's age unknown
    held = std::isnan(stamp) ? unknown : std::min(held, stamp);
  is_new = true;
}

void ChainAge::use(double now) {
  if (std::isnan(held)) return;
  const double age = now - held;
  ages.add(age);
  if (deadline && age > *deadline) ++missed;
}

ChainAge* DataAges::find(ChainId chain) {
  for (ChainAge& each : chains_)
    if (each.chain == chain) return &each;
  return nullptr;
}

void DataAges::begin() {
  for (ChainAge& chain : chains_) chain.is_new = false;
}

void DataAges::end(bool is_later, double now) {
  for (ChainAge& chain : chains_) {
    if (chain.deadline && (is_later || chain.is_new)) chain.use(now);
    chain.is_new = false;
  }
}

void DataAges::take(const std::vector<ChainId>& chains, const Stamps& stamps) {
  for (std::size_t i = 0; i < stamps.size(); ++i)
    if (ChainAge* chain = find(chains[i])) chain->take(stamps[i]);
}

Stamps DataAges::stamps(const std::vector<ChainId>& chains, double now) {
  Stamps found;
  found.reserve(chains.size());
  for (const ChainId each : chains) {
    ChainAge* chain = find(each);
    if (chain && !chain->is_first) chain->use(now);
    found.push_back(!chain ? unknown : chain->is_first ? now : chain->held);
  }
  return found;
}

DataAges::Held DataAges::held() const {
  Held found;
  for (const ChainAge& chain : chains_)
    if (!std::isnan(chain.held)) found.emplace_back(chain.chain, chain.held);
  return found;
}

void DataAges::restore(const Held& held) {
  for (const auto& [number, stamp] : held)
    if (ChainAge* chain = find(number)) chain->held = stamp;
}

}  // namespace poise::simulation
