// What a component's members are that lead to other components: published and required ports.
//
//   struct Heating {
//     poise::Method<double(double)> heat{"power"};        // the names of its parameters
//     poise::OneWay<std::string> note{"text"};
//   };
//   POISE_INTERFACE(Heating, heat, note)
#pragma once

#include <array>
#include <cstring>
#include <mutex>
#include <tuple>

#include "calls_api.hpp"
#include "messages.hpp"

namespace poise {

namespace detail {

inline const CallsApi& calls_api() {
  static const auto* api = [] {
    const Locked lock;
    const nb::object capsule = from_python("poise.runtime._calls", "native_api")();
    return static_cast<const CallsApi*>(PyCapsule_GetPointer(capsule.ptr(), calls_api_name));
  }();
  return *api;
}

// A provided method as components in C++ call it, whose types have the same layout.
// `arguments` is a tuple of references; the result is put into an optional, or what was thrown.
struct Target {
  std::string layout;
  void* object = nullptr;
  bool (*invoke)(const Target&, const void* arguments, void* result, Thrown& error) = nullptr;
  // holds a member function of any class
  std::array<std::byte, 32> method{};
};

// The provided methods of one component, by the function that Python calls.
struct Targets {
  std::map<PyObject*, Target> by_function;
};
constexpr const char* targets_name = "poise.cpp_targets";

// A way to a provided method in this container.
struct Link {
  nb::object function;  // keeps all else alive
  void* call;
  const Target* target;
  ~Link() {
    const Locked lock;
    function.reset();
  }
};

// The way to the target of a connector as `function` has it, if that leads to C++ directly.
inline std::shared_ptr<Link> link_of(nb::handle function, const std::string& layout) {
  void* call = calls_api().find(function.ptr());
  if (!call) return nullptr;
  PyObject* method = calls_api().method(call);
  if (!PyMethod_Check(method)) return nullptr;
  const nb::object capsule =
      nb::getattr(PyMethod_GET_SELF(method), "_cpp_targets", nb::none());
  if (!PyCapsule_IsValid(capsule.ptr(), targets_name)) return nullptr;
  const auto* targets =
      static_cast<const Targets*>(PyCapsule_GetPointer(capsule.ptr(), targets_name));
  const auto found = targets->by_function.find(PyMethod_GET_FUNCTION(method));
  if (found == targets->by_function.end() || found->second.layout != layout) return nullptr;
  return std::shared_ptr<Link>(new Link{nb::borrow(function), call, &found->second});
}

// Where a port or a method of one is in Python.
struct Place {
  PyObject* component = nullptr;  // borrowed: it owns the component in C++
  nb::handle port, method;  // their names, interned for good

  Place of(const char* port_name, const char* method_name = "publish") const {
    return {component, PyUnicode_InternFromString(port_name),
            PyUnicode_InternFromString(method_name)};
  }
  // Return a method of the port, under the GIL.
  nb::object function() const {
    if (!component) throw std::logic_error("a port is used that its component does not declare");
    return nb::handle(component).attr(port).attr(method);
  }
};

// What all methods of a required interface have.
class MethodBase {
 public:
  void attach(const Place& place) { place_ = place; }
  virtual void note(nb::handle) {}
  const Place& place() const { return place_; }
 protected:
  // Call it by way of Python, under the GIL.
  template <typename... Args>
  nb::object call_in_python(const Args&... args) const {
    try {
      return place_.function()(args...);
    } catch (nb::python_error& error) {
      throw_call_error(error);
    }
  }
  ~MethodBase() = default;
  Place place_;
};

template <typename Result>
using Held = std::conditional_t<std::is_void_v<Result>, bool, std::optional<Result>>;

// What a call by way of Python returned, under the GIL.
template <typename Result>
Result result_from(const nb::object& result, nb::handle method) {
  if constexpr (!std::is_void_v<Result>) {
    Result value{};
    if (!nb::try_cast(result, value))
      throw CannotCross(nb::cast<std::string>(method) + " returned a " +
                        nb::cast<std::string>(result.type().attr("__qualname__")));
    return value;
  }
}

}  // namespace detail

template <typename Signature>
class Method;

// A method of an interface. Of a required port it can be called, as a function.
template <typename Result, typename... Args>
class Method<Result(Args...)> : public detail::MethodBase {
 public:
  using Signature = Result(Args...);
  static constexpr bool is_oneway = false;
  std::array<const char*, sizeof...(Args)> names;

  template <typename... Names>
  Method(Names... parameters) : names{parameters...} {
    static_assert(sizeof...(Names) == sizeof...(Args), "name each parameter of the method");
  }

  // Waits up to the connector's limit; throws CallError.
  Result operator()(const Args&... args) const {
    if (const auto link = current(); link) {
      RunningDirectCall run;
      const Begin begun = detail::calls_api().begin(link->call, run);
      if (begun == Begin::entered) return finish(*link, run, std::tie(args...));
      if (begun == Begin::refused) throw Timeout(run.refusal);
    }
    const Locked lock;
    return detail::result_from<Result>(call_in_python(args...), place_.method);
  }

  // Use another function from now on.
  void note(nb::handle function) override {
    auto link = detail::link_of(function, layout());
    const std::lock_guard<std::mutex> guard(changing_);
    link_.swap(link);
  }

  static std::string layout() {
    std::string text = detail::layout<Result>() + "(";
    ((text += detail::layout<Args>() + ","), ...);
    return text + ")";
  }

 private:
  std::shared_ptr<detail::Link> current() const {
    const std::lock_guard<std::mutex> guard(changing_);
    return link_;
  }

  Result finish(const detail::Link& link, RunningDirectCall& run,
                const std::tuple<const Args&...>& args) const {
    detail::Held<Result> result{};
    detail::Thrown error;
    const bool is_done = link.target->invoke(*link.target, &args, &result, error);
    const bool in_time = detail::calls_api().end(link.call, run, !is_done);
    if (!is_done) throw CalleeError(error.type_name, error.message);
    if (!in_time) throw Timeout(run.refusal);
    if constexpr (!std::is_void_v<Result>) return std::move(*result);
  }

  mutable std::mutex changing_;
  std::shared_ptr<detail::Link> link_;
};

// A method whose caller does not wait: it queues like a message.
template <typename... Args>
class OneWay : public detail::MethodBase {
 public:
  using Signature = void(Args...);
  static constexpr bool is_oneway = true;
  std::array<const char*, sizeof...(Args)> names;

  template <typename... Names>
  OneWay(Names... parameters) : names{parameters...} {
    static_assert(sizeof...(Names) == sizeof...(Args), "name each parameter of the method");
  }

  void operator()(const Args&... args) const {
    const Locked lock;
    call_in_python(args...);
  }
};

#define POISE_BIND(method) bind(#method, &Interface::method, &Provider::method);
// All methods of an interface.
#define POISE_INTERFACE(Type, ...)                                                       \
  POISE_FIELDS(Type, (poise::MessageInfo{#Type, false, "interface"}), __VA_ARGS__)       \
  template <typename Provider, typename Interface, typename Bind>                        \
    requires std::is_same_v<Interface, Type>                                             \
  [[maybe_unused]] inline void poise_bind(const Interface*, const Provider*, Bind&& bind) { \
    POISE_FOR_EACH(POISE_BIND, __VA_ARGS__)                                              \
  }

// A required port: has the interface's methods, to be called from `activate` on.
template <typename Interface>
class Required : public Interface {};

namespace detail {

template <typename C, typename Pointer, typename Result, typename... Args>
Target target_of(C* object, Pointer method, std::type_identity<Result(Args...)>) {
  Target target;
  target.layout = Method<std::remove_cvref_t<Result>(std::remove_cvref_t<Args>...)>::layout();
  target.object = object;
  static_assert(sizeof(Pointer) <= sizeof target.method);
  std::memcpy(target.method.data(), &method, sizeof method);
  target.invoke = [](const Target& self, const void* arguments, void* result, Thrown& error) {
    Pointer called;
    std::memcpy(&called, self.method.data(), sizeof called);
    const auto& args =
        *static_cast<const std::tuple<const std::remove_cvref_t<Args>&...>*>(arguments);
    const auto run = [&](const auto&... values) -> Result {
      return (static_cast<C*>(self.object)->*called)(values...);
    };
    try {
      if constexpr (std::is_void_v<Result>)
        std::apply(run, args);
      else
        static_cast<std::optional<std::remove_cvref_t<Result>>*>(result)->emplace(
            std::apply(run, args));
      return true;
    } catch (...) {
      error = thrown();
      return false;
    }
  };
  return target;
}

}  // namespace detail

// A published topic.
template <Message M>
class Published {
 public:
  // Hand a message to every subscriber, in order.
  void publish(const M& message) const {
    const Locked lock;
    place_.function()(message);
  }
  void attach(const detail::Place& place) { place_ = place; }

 private:
  detail::Place place_;
};

}  // namespace poise
