#include "engine.h"

#include <algorithm>

namespace poise::simulation {

int Engine::number(const std::string& name) {
  const auto [found, is_new] = numbers_.try_emplace(name, static_cast<int>(names_.size()));
  if (is_new) names_.push_back(name);
  return found->second;
}

Executor* Engine::find(const Connector& connector) {
  if (connector.known && connector.known->is_there()) return connector.known;
  for (const Container& container : containers) {
    if (container.is_dead() || container.computer() != connector.target_computer) continue;
    if (Executor* found = container.find(connector.target)) return connector.known = found;
  }
  return nullptr;
}

bool Engine::runs(int component, const Executor* other_than) const {
  return std::any_of(containers.begin(), containers.end(), [=](const Container& each) {
    return !each.is_dead() && each.has(component, other_than);
  });
}

Stream& Engine::back(int source, int target) {
  Stream*& stream = back_[{source, target}];
  if (!stream) stream = &links.stream(source, target);
  return *stream;
}

void Engine::end() {
  events.clear();
  links.clear();
  for (Container& container : containers) container.end();
}

}  // namespace poise::simulation
