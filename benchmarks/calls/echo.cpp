// The callers and callees of `benchmarks.calls` in C++.
#include <algorithm>
#include <chrono>
#include <poise/component.hpp>

struct Echo {
  poise::Method<poise::Bytes(poise::Bytes)> echo{"data"};
  poise::Method<poise::Array<std::uint8_t>(poise::Array<std::uint8_t>)> echo_array{"data"};
};
POISE_INTERFACE(Echo, echo, echo_array)

// What the benchmark asks the caller: the time of each call [s], or of `batch` calls by turns.
struct Trips {
  poise::Method<std::vector<double>(int, int, int)> trips{"size", "count", "batch"};
};
POISE_INTERFACE(Trips, trips)

class Callee : public poise::Component {
 public:
  poise::Bytes echo(const poise::Bytes& data) { return data; }
  poise::Array<std::uint8_t> echo_array(const poise::Array<std::uint8_t>& data) { return data; }
};
POISE_COMPONENT(Callee) { component.provided<Echo>("calls"); }

class Caller : public poise::Component {
 public:
  poise::Required<Echo> calls;

  std::vector<double> trips(int size, int count, int batch) {
    constexpr int big = 1 << 16;  // what is larger is sent as an array, and read
    if (size < big) {
      const poise::Bytes data{std::string(static_cast<std::size_t>(size), '\1')};
      return timed(count, batch, [&] { calls.echo(data); });
    }
    poise::Array<std::uint8_t> data({static_cast<std::size_t>(size)});
    std::fill_n(data.writable(), data.size(), 1);
    return timed(count, batch, [&] {
      const auto answer = calls.echo_array(data);
      const auto* words = reinterpret_cast<const std::uint64_t*>(answer.data());
      largest_ = *std::max_element(words, words + answer.size() / sizeof *words);
    });
  }

 private:
  volatile std::uint64_t largest_ = 0;

  template <typename Call>
  static std::vector<double> timed(int count, int batch, const Call& call) {
    std::vector<double> times;
    for (int i = 0; i < count; ++i) {
      const auto began = std::chrono::steady_clock::now();
      for (int j = 0; j < batch; ++j) call();
      const std::chrono::duration<double> elapsed = std::chrono::steady_clock::now() - began;
      times.push_back(elapsed.count() / batch);
    }
    return times;
  }
};
POISE_COMPONENT(Caller) {
  component.provided<Trips>("trips");
  component.required("calls", &Caller::calls);
}
