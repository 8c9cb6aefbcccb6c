#include "sender.h"

#include "engine.h"

namespace poise::simulation {

constexpr std::size_t most_buffered = 1000;

void Sender::publish(Executor& source) {
  ++messages_;
  put({Item::Kind::message, ++connector_->slot->sent, stamps(source)});
}

void Sender::call(Executor& source, std::uint64_t number) {
  ++calls_;
  Events& events = container_.engine().events;
  if (number)
    events.at(events.now() + connector_->limit, [&source, number, over = connector_] {
      source.end_call(number, *over, nullptr);
    });
  put({Item::Kind::call, 0, stamps(source), {&source, number}});
}

void Sender::redirect(const Connector& connector) {
  connector_ = &connector;
  is_buffering_ = false;
  std::deque<Item> buffered;
  buffered.swap(buffer_);
  for (Item& item : buffered) send(std::move(item));
}

void Sender::close() {
  for (const auto& [key, stream] : routes_) stream->close();
  routes_.clear();
}

Stamps Sender::stamps(Executor& source) const {
  if (connector_->carries.empty()) return {};
  return source.ages().stamps(connector_->carries, container_.engine().events.now());
}

void Sender::put(Item item) {
  if (!is_buffering_) {
    send(std::move(item));
  } else if (buffer_.size() < most_buffered) {
    buffer_.push_back(std::move(item));
  } else {
    drop();
  }
}

void Sender::drop() {
  ++drops_;
  container_.engine().ledger.drop(*connector_->slot);
}

void Sender::send(Item item) {
  item.connector = connector_;
  if (connector_->is_direct) {
    container_.receive(std::move(item));
    return;
  }
  Engine& engine = container_.engine();
  const int here = container_.computer(), there = connector_->target_computer;
  if (connector_->source_cost > 0.0) container_.group().run(connector_->source_cost, nullptr);
  double size = connector_->size;
  if (item.kind == Item::Kind::call) {
    size /= 2;  // the other half is the answer's
    item.call.back = &engine.back(there, here);
    item.call.size = size;
  }
  route(here, there).send(size, [this, &engine, item = std::move(item)] {
    const Connector& connector = *item.connector;
    if (Executor* target = engine.find(connector))
      target->container().receive(item);
    else if (item.kind == Item::Kind::message && !engine.runs(connector.target.component))
      drop();  // it is to begin
  });
}

Stream& Sender::route(int here, int there) {
  Stream*& stream = routes_[connector_->key_number];
  if (!stream || stream->is_closed()) stream = &container_.engine().links.stream(here, there);
  return *stream;
}

}  // namespace poise::simulation
