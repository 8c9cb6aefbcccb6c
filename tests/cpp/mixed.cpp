// Components that tests join with ones in Python: each has a twin there, in test_cpp_components.py.
#include <atomic>
#include <chrono>
#include <poise/component.hpp>
#include <thread>

struct Point {
  double x, y;
};
POISE_MESSAGE(Point, x, y)

struct Everything {
  int number;
  double real;
  bool flag;
  std::string text;
  std::vector<Point> points;
  std::optional<std::string> maybe;
  std::map<std::string, double> named;
  std::array<double, 2> two;
  poise::Bytes raw;
  poise::Array<float> array;
  poise::Stamp at;
};
POISE_MESSAGE(Everything, number, real, flag, text, points, maybe, named, two, raw, array, at)

struct Number {
  int value;
};
POISE_MESSAGE(Number, value)

struct Sums {
  poise::Method<int(int, int)> add{"one", "two"};
  poise::Method<Everything(Everything)> echo{"everything"};
  poise::Method<void(std::string)> fail{"why"};
  poise::Method<void(double)> wait{"seconds"};
  poise::Method<int(int)> back{"depth"};
  poise::OneWay<std::string> note{"text"};
};
POISE_INTERFACE(Sums, add, echo, fail, wait, back, note)

struct Backs {
  poise::Method<int(int)> further{"depth"};
};
POISE_INTERFACE(Backs, further)

namespace trouble {
struct Empty : std::runtime_error {
  using std::runtime_error::runtime_error;
};
struct Late : poise::Timeout {
  using poise::Timeout::Timeout;
};
}  // namespace trouble

static void spin_or_sleep(double seconds) {
  std::this_thread::sleep_for(std::chrono::duration<double>(seconds));
}

// A second base lies elsewhere in the object than the first.
class Counts {
 public:
  virtual ~Counts() = default;
  poise::Published<Number> heard;
  int calls = 7;

  void number(const Number& message) { heard.publish({message.value + 1 + calls - 7}); }
};

// What a component has from its bases, and const methods, are as good as its own.
class Target : public poise::Component, public Counts {
 public:
  poise::Required<Backs> backs;

  int add(int one, int two) const noexcept { return one + two; }
  Everything echo(const Everything& everything) {
    Everything more = everything;
    ++more.number;
    return more;
  }
  void fail(const std::string& why) {
    if (why == "late") throw trouble::Late(why);
    throw trouble::Empty(why);
  }
  void wait(double seconds) { spin_or_sleep(seconds); }
  int back(int depth) { return depth > 0 ? 1 + backs.further(depth - 1) : 0; }
  void note(const std::string& text) { heard.publish({static_cast<int>(text.size())}); }
  void picture(const Everything& message) {
    double sum = 0.0;
    for (const float value : message.array) sum += value;
    heard.publish({static_cast<int>(sum)});
  }
};
POISE_COMPONENT(Target) {
  component.provided<Sums>("sums");
  component.required("backs", &Target::backs);
  component.published("heard", &Target::heard, poise::latest);
  component.subscribed("number", &Target::number, poise::block(4));
  component.subscribed("picture", &Target::picture, poise::block(4));
}

// What a test makes it do, by its port `ask`.
struct Asks {
  poise::Method<int(int, int)> add{"one", "two"};
  poise::Method<Everything(Everything)> echo{"everything"};
  poise::Method<std::vector<std::string>(std::string)> fail{"why"};
  poise::Method<std::string(double)> wait{"seconds"};
  poise::Method<int(int)> back{"depth"};
  poise::Method<void(std::string)> note{"text"};
  poise::Method<void(int)> publish{"value"};
  poise::Method<void()> show;
  poise::Method<int(double)> keep_adding{"seconds"};
  poise::Method<std::string(double)> start{"limit"};
  poise::Method<std::vector<std::string>()> taken;
};
POISE_INTERFACE(Asks, add, echo, fail, wait, back, note, publish, show, keep_adding, start, taken)

class Source : public poise::Component {
 public:
  poise::Required<Sums> sums;
  poise::Published<Number> number;
  poise::Published<Everything> picture;

  int add(int one, int two) { return sums.add(one, two); }
  Everything echo(const Everything& everything) { return sums.echo(everything); }
  std::vector<std::string> fail(const std::string& why) {
    try {
      sums.fail(why);
    } catch (const poise::CalleeError& error) {
      return {error.type_name, error.message};
    }
    return {};
  }
  std::string wait(double seconds) {
    try {
      sums.wait(seconds);
    } catch (const poise::Timeout& error) {
      return error.what();
    }
    return "";
  }
  int back(int depth) { return sums.back(depth); }
  int further(int depth) { return depth > 0 ? 1 + sums.back(depth - 1) : 0; }
  void note(const std::string& text) { sums.note(text); }
  void publish(int value) { number.publish({value}); }
  void show() {
    poise::Array<float> array({200, 200});
    std::fill_n(array.writable(), array.size(), 0.5f);
    picture.publish({1, 2.0, true, "shown", {}, std::nullopt, {}, {}, {}, array, stamp()});
  }
  int keep_adding(double seconds) {
    const auto end = std::chrono::steady_clock::now() + std::chrono::duration<double>(seconds);
    int calls = 0;
    while (std::chrono::steady_clock::now() < end) calls += sums.add(1, 1) == 2;
    return calls;
  }
  // Start calls while the target answers none; say what the one that waits brings, within a limit.
  std::string start(double limit) {
    start_call(sums.add, 2, 3).then([this](const poise::StartedCall<int>& call) {
      taken_.push_back(std::to_string(call.result()));
    });
    start_call(sums.fail, "no eggs").then([this](const auto& call) {
      try {
        call.result();
      } catch (const poise::CalleeError& error) {
        taken_.push_back(error.message);
      }
    });
    const auto dropped = start_call(sums.add, 1, 1);
    dropped.then([this](const auto&) { taken_.push_back("was cancelled"); });
    const bool was_to_come = !dropped.done() && dropped.cancel() && dropped.done();
    try {
      dropped.result();
    } catch (const poise::Cancelled&) {
      taken_.push_back(was_to_come ? "cancelled" : "too late");
    }
    try {
      const poise::Within within(limit);
      start_call(sums.wait, 0.0).result();
    } catch (const poise::Timeout& error) {
      return error.what();
    }
    return "";
  }
  std::vector<std::string> taken() { return taken_; }

 private:
  std::vector<std::string> taken_;
};
POISE_COMPONENT(Source) {
  component.provided<Asks>("asks");
  component.provided<Backs>("backs");
  component.required("sums", &Source::sums);
  component.published("number", &Source::number);
  component.published("picture", &Source::picture);
}

// What goes wrong in one says more than a text can hold.
struct Mutters {
  poise::Method<void()> mutter, complain, pass_on;
};
POISE_INTERFACE(Mutters, mutter, complain, pass_on)

class Mutterer : public poise::Component {
 public:
  poise::Required<Mutters> others;

  void mutter() { throw trouble::Empty("no \xff"); }
  void complain() { warning("low \xff"); }
  void pass_on() {
    const poise::Locked lock;
    python().attr("fail")();
  }
  // What is caught of an error in Python that passed through another one.
  std::string caught() {
    try {
      others.pass_on();
    } catch (const poise::CalleeError& error) {
      return error.message;
    }
    return "";
  }
};
struct Catches {
  poise::Method<std::string()> caught;
};
POISE_INTERFACE(Catches, caught)
POISE_COMPONENT(Mutterer) {
  component.provided<Mutters>("mutters");
  component.provided<Catches>("catches");
  component.required("others", &Mutterer::others);
}

// Its thread publishes until it is joined.
class Busy : public poise::Component {
 public:
  poise::Published<Number> number;

  ~Busy() override {
    is_ending_ = true;
    if (thread_.joinable()) thread_.join();
  }
  void activate() override {
    thread_ = std::thread([this] {
      while (!is_ending_) number.publish({1});
      number.publish({2});
    });
  }

 private:
  std::atomic<bool> is_ending_{false};
  std::thread thread_;
};
POISE_COMPONENT(Busy) { component.published("number", &Busy::number); }

// Its thread asks for the interpreter's lock for as long as the process lives.
class Endless : public poise::Component {
 public:
  void activate() override {
    std::thread([this] {
      while (true) now();
    }).detach();
  }
};
POISE_COMPONENT(Endless) { (void)component; }

// Two of these meet only when their handlers run at the same time.
static std::atomic<int> num_inside{0};

class Meeting : public poise::Component {
 public:
  void meet() {
    ++num_inside;
    const auto end = std::chrono::steady_clock::now() + std::chrono::seconds(20);
    while (num_inside < 2 && std::chrono::steady_clock::now() < end) std::this_thread::yield();
    measure("met", num_inside >= 2);
  }
};
POISE_COMPONENT(Meeting) { component.every(0.02, "meet", &Meeting::meet); }

// The components of examples/counted in C++: what is lost, doubled or late shows.
struct Doubles {
  poise::Method<int(int)> double_it{"value"};
};
POISE_INTERFACE(Doubles, double_it)

struct SourceState {
  int sent = 0, answered = 0, failed = 0;
};
POISE_MESSAGE(SourceState, sent, answered, failed)

class CountingSource : public poise::Component {
 public:
  poise::Published<Number> numbers;
  poise::Required<Doubles> doubles;

  void produce() {
    numbers.publish({++state_.sent});
    if (state_.sent % 10 != 0) return;
    try {
      state_.answered += doubles.double_it(state_.sent) == 2 * state_.sent;
    } catch (const poise::CallError&) {
      ++state_.failed;
    }
  }
  void tell() {
    measure("sent", state_.sent);
    measure("answered", state_.answered);
    measure("failed", state_.failed);
  }
  SourceState snapshot() noexcept { return state_; }
  void restore(const SourceState& state) { state_ = state; }

 private:
  SourceState state_;
};
POISE_COMPONENT(CountingSource) {
  component.published("numbers", &CountingSource::numbers);
  component.required("doubles", &CountingSource::doubles);
  component.every(0.005, "produce", &CountingSource::produce);
  component.every(0.2, "tell", &CountingSource::tell, 0.2);
}

struct PasserState {
  poise::Bytes ballast;
};
POISE_MESSAGE(PasserState, ballast)

struct Load {
  int ballast = 100'000;
};
POISE_PARAMETERS(Load, ballast)

class CountingPasser : public poise::Component {
 public:
  poise::Published<Number> passed;
  Load parameters;

  void configure() override { state_.ballast.data.assign(parameters.ballast, ' '); }
  int double_it(int value) { return 2 * value; }
  void numbers(const Number& message) { passed.publish(message); }
  PasserState snapshot() const { return state_; }
  void restore(const PasserState& state) { state_ = state; }

 private:
  PasserState state_;
};
POISE_COMPONENT(CountingPasser) {
  component.published("passed", &CountingPasser::passed);
  component.provided<Doubles>("doubles");
  component.subscribed("numbers", &CountingPasser::numbers, poise::block(2000));
}
