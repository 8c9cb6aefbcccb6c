// The controller of an oven, and its heater.
#include <algorithm>
#include <poise/component.hpp>

struct Reading {
  double celsius;
  poise::Stamp taken;
};
POISE_MESSAGE(Reading, celsius, taken)

struct Heating {
  poise::Method<double(double)> heat{"power"};
  poise::OneWay<std::string> note{"text"};
};
POISE_INTERFACE(Heating, heat, note)

struct Gains {
  double gain = 0.05;
  double target = 180.0;  // [degrees]
};
POISE_PARAMETERS(Gains, gain, target)

struct Learned {
  double gain;
  int readings;
};
POISE_MESSAGE(Learned, gain, readings)

class Controller : public poise::Component {
 public:
  poise::Required<Heating> heating;
  poise::Published<Learned> learned;
  Gains parameters;

  void configure() override { state_ = {parameters.gain, 0}; }

  void on_reading(const Reading& message) {
    if (const auto age = since(message.taken)) measure("age", age->value);
    const double missing = parameters.target - message.celsius;
    try {
      measure("watts", heating.heat(std::clamp(state_.gain * missing, 0.0, 1.0)));
    } catch (const poise::CalleeError& error) {  // it threw, or raised
      warning("the heater refused: " + error.message);
    } catch (const poise::CallError& error) {  // Timeout, Unavailable, CannotCross
      warning(std::string("no heat this time: ") + error.what());
    }
    ++state_.readings;
  }
  void tell() { learned.publish(state_); }

  void reconfigure(const Gains& wanted) {
    if (wanted.gain > 1) throw std::invalid_argument("such a gain would make it swing");
    state_.gain = wanted.gain;
  }

  Learned snapshot() const { return state_; }
  void restore(const Learned& state) { state_ = state; }

 private:
  Learned state_;
};

POISE_COMPONENT(Controller) {
  component.required("heating", &Controller::heating);
  component.published("learned", &Controller::learned);
  component.subscribed("reading", &Controller::on_reading, poise::keep(1));
  component.every(0.5, "tell", &Controller::tell, 0.5);  // period and deadline [s]
}

class Heater : public poise::Component {
 public:
  double heat(double power) {
    if (!(power >= 0 && power <= 1)) throw std::invalid_argument("power must lie in [0, 1]");
    return power * 2000;  // [W]
  }
  void note(const std::string& text) { info(text); }
};

POISE_COMPONENT(Heater) { component.provided<Heating>("heating"); }
