#include "links.h"

#include <algorithm>

#include "elementary.h"

namespace poise::simulation {

// Between two processes of one computer [s].
constexpr double local = 40e-6;
// After a cut, TCP sends again within this time, or the length of the cut [s].
constexpr double back_off = 1.5;

Way& Links::way(int source, int target) {
  return ways_.try_emplace({source, target}, Way{source, target, usual_}).first->second;
}

void Links::cut(int source, int target) { way(source, target).cuts.push_back(events_.now()); }

void Links::heal(int source, int target) {
  Way& way = this->way(source, target);
  if (way.cuts.empty()) return;
  const double lasted = events_.now() - way.cuts.front();
  way.cuts.pop_front();
  if (!way.cuts.empty()) return;
  for (Stream* stream : way.streams) {
    const double pause = std::min(lasted, back_off) * draws_.next();
    events_.at(events_.now() + pause, [stream] { stream->send_held(); });
  }
}

void Links::clog(int source, int target, double seconds) {
  double& until = way(source, target).clogged_until;
  until = std::max(until, events_.now() + seconds);
}

double Links::arrival(Way& way, double size) {
  const double now = events_.now();
  if (way.source == way.target) return now + local;
  const double begin = std::max({now, way.clogged_until, way.free_at});
  // one after the other: what is sent meanwhile waits
  way.free_at = begin + size / way.model.bandwidth;
  const double jitter = -logarithm(1.0 - uniform(jitter_));
  return way.free_at + way.model.latency + way.model.jitter * jitter;
}

double Links::time_for(int source, int target, double size) {
  if (source == target) return local;
  const LinkModel& model = way(source, target).model;
  return model.latency + size / model.bandwidth;
}

Stream& Links::stream(int source, int target) {
  Stream& stream = streams_.emplace_back(*this, way(source, target));
  stream.way_.streams.push_back(&stream);
  return stream;
}

void Links::clear() {
  for (Stream& stream : streams_) stream.held_.clear();
}

void Stream::send(double size, Action deliver) {
  if (is_closed_) return;
  if (!held_.empty() || is_cut()) {
    held_.emplace_back(size, std::move(deliver));
    return;
  }
  last_ = std::max(links_.arrival(way_, size), last_);
  events().at(last_, [this, deliver = std::move(deliver)] {
    if (!is_closed_) deliver();
  });
}

Events& Stream::events() const { return links_.events_; }

void Stream::close() {
  is_closed_ = true;
  held_.clear();
  auto& streams = way_.streams;
  streams.erase(std::remove(streams.begin(), streams.end(), this), streams.end());
}

void Stream::send_held() {
  if (is_cut()) return;
  std::deque<std::pair<double, Action>> held;
  held.swap(held_);
  for (auto& [size, deliver] : held) send(size, std::move(deliver));
}

}  // namespace poise::simulation
