// A component in C++ (docs/cpp-components.md).
//
//   class Controller : public poise::Component {
//    public:
//     poise::Required<Heating> heating;
//     void reading(const Reading& message) { heating.heat(0.4); }
//   };
//   POISE_COMPONENT(Controller) {
//     component.required("heating", &Controller::heating);
//     component.subscribed("reading", &Controller::reading, poise::keep(1));
//   }
//
// Its code runs without the interpreter's lock; what leads to Python takes it by itself.
#pragma once

#include <concepts>
#include <functional>
#include <utility>

#include "started_call.hpp"

namespace poise {

// How a subscribed port queues: the last `size` messages, or publishers wait at `size`.
struct Queue {
  const char* policy;
  int size;
};
inline Queue keep(int size) { return {"keep", size}; }
inline Queue block(int size) { return {"block", size}; }

// How a port publishes: with `latest`, late subscribers get its last message.
struct Publication {
  bool latest = false;
};
inline constexpr Publication latest{true};

// The base of all components; each hook is as in Python. One thread at a time runs its code.
class Component {
 public:
  virtual ~Component() = default;
  virtual void configure() {}
  virtual void activate() {}
  virtual void begin(const std::string& /*action*/) {}
  virtual void deactivate() {}
  virtual void cleanup() {}

  std::string name() const { return get<std::string>("name"); }
  // The path of a device that the robot file gives it.
  std::string device(const std::string& name) const { return call<std::string>("device", name); }
  // Count a value under a name.
  void measure(const std::string& name, double value) const { call<void>("measure", name, value); }

  void info(const std::string& text) const { log("info", text); }
  void warning(const std::string& text) const { log("warning", text); }
  void error(const std::string& text) const { log("error", text); }

  double now() const { return with_clock<double>("now"); }  // [s]
  Stamp stamp() const { return with_clock<Stamp>("stamp"); }
  Stamp stamp(double at) const { return with_clock<Stamp>("stamp", at); }
  // How long ago a stamp was, on whatever computer; none: its clock is not known yet.
  std::optional<Elapsed> since(const Stamp& stamp) const {
    return with_clock<std::optional<Elapsed>>("since", stamp);
  }

  // Start a call without waiting for it, so that two can be asked at once. The connector's limit
  // holds, and that of `Within`, from now on.
  template <typename Result, typename... Args>
  StartedCall<Result> start_call(const Method<Result(Args...)>& method,
                                 const std::type_identity_t<Args>&... args) const {
    const Locked lock;
    return {python_.attr("start_call")(method.place().function(), args...), method.place().method};
  }

  // The component in Python; use it under `poise::Locked`.
  nb::handle python() const { return python_; }
  void attach(nb::handle python) { python_ = python; }

 private:
  template <typename Result>
  Result get(const char* name) const {
    const Locked lock;
    return nb::cast<Result>(python_.attr(name));
  }
  template <typename Result, typename... Args>
  Result call(const char* name, const Args&... args) const {
    const Locked lock;
    return nb::cast<Result>(python_.attr(name)(args...));
  }
  template <typename Result, typename... Args>
  Result with_clock(const char* name, const Args&... args) const {
    const Locked lock;
    return nb::cast<Result>(python_.attr("clock").attr(name)(args...));
  }
  void log(const char* level, const std::string& text) const {
    const Locked lock;
    python_.attr("log").attr(level)("%s", detail::text_from(text));
  }

  nb::handle python_;
};

// How much time the caller of the call on this thread still waits [s].
inline double time_left() {
  const Locked lock;
  return nb::cast<double>(detail::from_python("poise", "time_left")());
}

namespace detail {

// The type of a state, whether `snapshot` returns it or an optional of it.
template <typename T>
struct StateOf {
  using type = T;
};
template <typename T>
struct StateOf<std::optional<T>> {
  using type = T;
};

// What a method takes and returns. It may be const or noexcept, and of a base class.
template <typename Method>
struct MethodOf;
template <typename Result, typename C, typename... Args, bool is_noexcept>
struct MethodOf<Result (C::*)(Args...) noexcept(is_noexcept)> {
  using Signature = Result(Args...);
};
template <typename Result, typename C, typename... Args, bool is_noexcept>
struct MethodOf<Result (C::*)(Args...) const noexcept(is_noexcept)> {
  using Signature = Result(Args...);
};
template <typename Method>
using SignatureOf = std::type_identity<typename MethodOf<Method>::Signature>;

// What a class in C++ tells Python of itself, and how an instance is made.
struct Made {
  nb::dict functions;  // name -> what Python calls, with the component first
  Targets* targets;
};

}  // namespace detail

// What POISE_COMPONENT fills: the ports and timers of a class.
template <typename C>
class Declaration {
 public:
  // Call a method every `period` [s]; a run that has not ended `deadline` [s] after its release
  // is late.
  template <typename Method>
    requires std::invocable<Method, C&>
  void every(double period, const char* name, Method method,
             std::optional<double> deadline = std::nullopt) {
    timers_.append(nb::make_tuple(name, period, deadline));
    add_function(name, method);
  }

  template <typename Method>
  void subscribed(const char* port, Method method, Queue queue = keep(1)) {
    subscribed_.append(nb::make_tuple(port, queue.policy, queue.size, taken_by<Method>()));
    add_function(port, method);
  }

  template <typename M, typename Base>
    requires std::derived_from<C, Base>
  void published(const char* port, Published<M> Base::*member, Publication publication = {}) {
    published_[port] = detail::python_type<M>();
    if (publication.latest) latest_.append(port);
    on_instance([=](C& object, const detail::Place& place) { (object.*member).attach(place.of(port)); });
  }

  template <typename Interface, typename Base>
    requires std::derived_from<C, Base>
  void required(const char* port, Required<Interface> Base::*member) {
    required_[port] = interface_class<Interface>();
    on_instance([=](C& object, const detail::Place& place) {
      poise_visit(static_cast<Interface&>(object.*member), [&](const char* name, auto& method) {
        method.attach(place.of(port, name));
      });
    });
    links_[port] = [=](C& object, const std::string& name, nb::handle function) {
      poise_visit(static_cast<Interface&>(object.*member), [&](const char* known, auto& method) {
        if (name == known) method.note(function);
      });
    };
  }

  // The class has the interface's methods.
  template <typename Interface>
  void provided(const char* port) {
    provided_[port] = interface_class<Interface>();
    const Interface interface;
    poise_bind(static_cast<const Interface*>(nullptr), static_cast<const C*>(nullptr),
               [&](const char* name, auto declared, auto method) {
                 check_fits(declared, detail::SignatureOf<decltype(method)>());
                 add_function(name, method, (interface.*declared).names, true);
               });
  }

  nb::object make_class(const char* name) {
    add_hooks();
    nb::dict types;
    types["published"] = published_;
    types["latest"] = latest_;
    types["required"] = required_;
    types["provided"] = provided_;
    types["subscribed"] = subscribed_;
    types["timers"] = timers_;
    types["hooks"] = hooks_;
    if constexpr (requires { C::reentrant; }) types["reentrant"] = C::reentrant;
    if constexpr (requires { &C::parameters; })
      types["parameters"] = detail::python_type<decltype(C::parameters)>();
    auto self = std::make_shared<Declaration>(std::move(*this));
    nb::object make = nb::cpp_function([self](nb::handle component) { return self->make(component); });
    return detail::made_class("component", name, types, make);
  }

 private:
  using Instance = std::shared_ptr<C>;

  template <typename Interface>
  static nb::object interface_class() {
    static const auto* made = [] {
      nb::list methods;
      const Interface interface;
      poise_visit(interface, [&](const char* name, const auto& method) {
        methods.append(nb::make_tuple(name, described(method), method.is_oneway));
      });
      const char* name = poise_info(static_cast<const Interface*>(nullptr)).name;
      return new nb::object(detail::made_class("interface", name, methods));
    }();
    return *made;
  }

  // The annotations of an interface's method: its parameters, and `return`.
  template <typename M>
  static nb::dict described(const M& method) {
    return [&]<typename Result, typename... Args>(std::type_identity<Result(Args...)>) {
      nb::dict types;
      std::size_t place = 0;
      ((types[method.names[place++]] = detail::python_type<Args>()), ...);
      types["return"] = detail::python_type<Result>();
      return types;
    }(std::type_identity<typename M::Signature>());
  }

  template <typename Interface, typename M, typename Result, typename... Args>
  static void check_fits(M Interface::*, std::type_identity<Result(Args...)>) {
    static_assert(
        std::is_same_v<typename M::Signature,
                       std::remove_cvref_t<Result>(std::remove_cvref_t<Args>...)>,
        "a provided method takes or returns other types than its interface declares");
  }

  void on_instance(std::function<void(C&, const detail::Place&)> do_) {
    on_instance_.push_back(std::move(do_));
  }

  // Let Python call a method; `names` are of its parameters.
  template <typename Method, std::size_t Size = 0>
  void add_function(const char* name, Method method, std::array<const char*, Size> names = {},
                    bool is_target = false) {
    functions_.push_back([=](const Instance& object, detail::Made& made) {
      nb::object callable = named(released(object, method), name, names,
                                  std::make_index_sequence<Size>());
      if (is_target)
        made.targets->by_function[callable.ptr()] =
            detail::target_of(object.get(), method, detail::SignatureOf<Method>());
      made.functions[name] = callable;
    });
  }

  // A method as Python calls it, with the component first; the GIL is released meanwhile.
  template <typename Method>
  static auto released(const Instance& object, Method method) {
    return [&]<typename Result, typename... Args>(std::type_identity<Result(Args...)>) {
      return [object, method](nb::handle, const std::remove_cvref_t<Args>&... args) {
        return detail::run_released([&] { return (object.get()->*method)(args...); });
      };
    }(detail::SignatureOf<Method>());
  }

  template <typename Function, std::size_t Size, std::size_t... Places>
  static nb::object named(Function function, const char* name,
                          const std::array<const char*, Size>& names,
                          std::index_sequence<Places...>) {
    if constexpr (Size == 0)
      return nb::cpp_function(std::move(function), nb::name(name));
    else
      return nb::cpp_function(std::move(function), nb::name(name), nb::arg("self"),
                              nb::arg(names[Places])...);
  }

  // Let Python call a function with the component; `parameter` is the type that a hook takes.
  template <typename Function>
  void add_hook(const char* name, Function function, nb::object parameter = nb::none()) {
    hooks_[name] = parameter;
    functions_.push_back([=](const Instance& object, detail::Made& made) {
      made.functions[name] = function(object);
    });
  }

  void add_hooks() {
    for (const auto& [name, hook] : {std::pair{"configure", &Component::configure},
                                     {"activate", &Component::activate},
                                     {"deactivate", &Component::deactivate},
                                     {"cleanup", &Component::cleanup}})
      add_hook(name, [hook = hook](const Instance& object) {
        return nb::cpp_function([object, hook](nb::handle) {
          detail::run_released([&] { (object.get()->*hook)(); });
        });
      });
    add_hook("begin", [](const Instance& object) {
      return nb::cpp_function([object](nb::handle, const std::string& action) {
        detail::run_released([&] { object->begin(action); });
      });
    }, detail::builtin("str"));
    if constexpr (requires(C& c) { c.snapshot(); }) add_giver("snapshot", &C::snapshot);
    if constexpr (requires(C& c) { c.snapshot_delta(); })
      add_giver("snapshot_delta", &C::snapshot_delta);
    if constexpr (requires { &C::restore; }) add_taker("restore", &C::restore);
    if constexpr (requires { &C::restore_delta; }) add_taker("restore_delta", &C::restore_delta);
    if constexpr (requires { &C::reconfigure; }) add_reconfigure(&C::reconfigure);
  }

  template <typename Method>
  void add_giver(const char* name, Method method) {
    [&]<typename State>(std::type_identity<State()>) {
      static_assert(Message<typename detail::StateOf<State>::type>,
                    "list the fields of the state by POISE_MESSAGE");
    }(detail::SignatureOf<Method>());
    add_hook(name, [method](const Instance& object) {
      return nb::cpp_function(released(object, method));
    });
  }

  template <typename Method>
  void add_taker(const char* name, Method method) {
    add_hook(name, [method](const Instance& object) {
      return nb::cpp_function(released(object, method));
    }, taken_by<Method>());
  }

  template <typename Method>
  void add_reconfigure(Method method) {
    add_hook("reconfigure", [method](const Instance& object) {
      return nb::cpp_function([object, method](nb::handle, const decltype(C::parameters)& parameters) {
        detail::run_released([&] {
          (object.get()->*method)(parameters);
          object->parameters = parameters;
        });
      });
    }, taken_by<Method>());
  }

  // The type in Python of what a method takes.
  template <typename Method>
  static nb::object taken_by() {
    return []<typename Taken>(std::type_identity<void(Taken)>) {
      return detail::python_type<Taken>();
    }(detail::SignatureOf<Method>());
  }

  // Return what an instance of the class in Python needs: its functions, what tells it of other
  // routes, and its targets.
  nb::tuple make(nb::handle component) {
    // its threads may take the interpreter's lock until its destructor has joined them
    const Instance object(new C(), [](C* ending) {
      const Unlocked unlocked;
      delete ending;
    });
    object->attach(component);
    if constexpr (requires { &C::parameters; })
      object->parameters = nb::cast<decltype(C::parameters)>(component.attr("parameters"));
    for (const auto& do_ : on_instance_) do_(*object, detail::Place{component.ptr(), {}, {}});
    auto targets = std::make_unique<detail::Targets>();
    detail::Made made{nb::dict(), targets.get()};
    for (const auto& add : functions_) add(object, made);
    const auto links = links_;
    nb::object note = nb::cpp_function(
        [object, links](const std::string& port, const std::string& name, nb::handle function) {
          const auto found = links.find(port);
          if (found != links.end()) found->second(*object, name, function);
        });
    nb::capsule capsule(targets.release(), detail::targets_name, [](void* pointer) noexcept {
      delete static_cast<detail::Targets*>(pointer);
    });
    return nb::make_tuple(made.functions, note, capsule);
  }

  nb::dict published_, required_, provided_, hooks_;
  nb::list latest_, subscribed_, timers_;
  std::vector<std::function<void(C&, const detail::Place&)>> on_instance_;
  std::vector<std::function<void(const Instance&, detail::Made&)>> functions_;
  std::map<std::string, std::function<void(C&, const std::string&, nb::handle)>> links_;
};

namespace detail {

using Definition = std::function<void()>;

// The components of this library.
inline std::vector<Definition>& definitions() {
  static std::vector<Definition> all;
  return all;
}

template <typename C>
bool define(const char* name, void (*declare)(Declaration<C>&)) {
  static_assert(std::is_base_of_v<Component, C>, "a component inherits from poise::Component");
  definitions().push_back([=] {
    Declaration<C> declaration;
    declare(declaration);
    declaration.make_class(name);
  });
  return true;
}

}  // namespace detail

#define POISE_COMPONENT(Type)                                                               \
  static void poise_declare(::poise::Declaration<Type>& component);                         \
  [[maybe_unused]] static const bool poise_defined_##Type = ::poise::detail::define<Type>( \
      #Type, static_cast<void (*)(::poise::Declaration<Type>&)>(&poise_declare));           \
  static void poise_declare([[maybe_unused]] ::poise::Declaration<Type>& component)

// Once in each module; `poise_add_component` writes it.
#define POISE_MODULE(name)                                                       \
  NB_MODULE(name, module) {                                                      \
    poise::detail::from_python("poise.cmake", "check_built")(#name, POISE_BUILT_FOR); \
    nanobind::set_leak_warnings(false);                                          \
    for (const auto& define : poise::detail::definitions()) define();            \
    for (const auto [class_name, made] : poise::detail::made_classes())          \
      nanobind::setattr(module, class_name, made);                               \
  }

}  // namespace poise
