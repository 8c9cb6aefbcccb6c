// Keeps an oven warm: the controller of docs/writing-components.md in C++.
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
  double gain;
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
  Gains parameters;

  void configure() override { learned_ = {parameters.gain, 0}; }

  void reading(const Reading& message) {
    if (const auto age = since(message.taken)) measure("age", age->value);
    const double missing = parameters.target - message.celsius;
    try {
      measure("watts", heating.heat(std::clamp(learned_.gain * missing, 0.0, 1.0)));
    } catch (const poise::CalleeError& error) {
      warning("the heater refused: " + error.message);
    } catch (const poise::CallError& error) {  // Timeout, Unavailable
      warning(std::string("no heat this time: ") + error.what());
    }
    ++learned_.readings;
  }

  Learned snapshot() { return learned_; }
  void restore(const Learned& state) { learned_ = state; }

  void reconfigure(const Gains& wanted) {
    if (wanted.gain > 1) throw std::invalid_argument("such a gain would make it swing");
    learned_.gain = wanted.gain;
  }

 private:
  Learned learned_;
};

POISE_COMPONENT(Controller) {
  component.required("heating", &Controller::heating);
  component.subscribed("reading", &Controller::reading, poise::keep(1));
}

// The heater in C++, too: a call between both does not leave C++.
class Heater : public poise::Component {
 public:
  double heat(double power) {
    if (!(power >= 0.0 && power <= 1.0)) throw std::invalid_argument("power must lie in [0, 1]");
    return power * 2000;  // [W]
  }
  void note(const std::string& text) { info(text); }
};

POISE_COMPONENT(Heater) { component.provided<Heating>("heating"); }
