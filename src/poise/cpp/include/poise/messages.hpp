// Messages: structs whose fields are listed once, and arrays that nothing copies.
//
//   struct Reading { double celsius; poise::Stamp taken; };
//   POISE_MESSAGE(Reading, celsius, taken)      // in the namespace of the struct
//
// In Python it is a `poise.Message` with the same fields, in the module of the component.
#pragma once

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/detail/nb_array.h>
#include <nanobind/stl/map.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include <array>
#include <cstddef>
#include <limits>
#include <map>
#include <memory>
#include <numeric>
#include <optional>
#include <stdexcept>
#include <string>
#include <type_traits>
#include <vector>

#include "errors.hpp"
#include "for_each.hpp"

namespace poise {

struct MessageInfo {
  const char* name;
  bool has_defaults;         // a field that is left out has the value that C++ gives it
  const char* python_class;  // "module:name" of one that exists; null: it is made
};

#define POISE_VISIT(field) visit(#field, self.field);
#define POISE_FIELDS(Type, info, ...)                                               \
  template <typename Self, typename Visit>                                          \
    requires std::is_same_v<std::remove_const_t<Self>, Type>                        \
  [[maybe_unused]] inline void poise_visit(Self& self, Visit&& visit) {             \
    POISE_FOR_EACH(POISE_VISIT, __VA_ARGS__)                                        \
  }                                                                                 \
  [[maybe_unused]] inline constexpr poise::MessageInfo poise_info(const Type*) { return info; }

// All fields of a message or state, in their order.
#define POISE_MESSAGE(Type, ...) \
  POISE_FIELDS(Type, (poise::MessageInfo{#Type, false, nullptr}), __VA_ARGS__)
// All parameters; one that the robot file leaves out has the value that C++ gives it.
#define POISE_PARAMETERS(Type, ...) \
  POISE_FIELDS(Type, (poise::MessageInfo{#Type, true, nullptr}), __VA_ARGS__)

template <typename T>
concept Message = requires(const T* message) {
  { poise_info(message) } -> std::same_as<MessageInfo>;
};

// A moment `at` [s] on the clock of a computer.
struct Stamp {
  double at = 0.0;
  std::string computer;
};
POISE_FIELDS(Stamp, (MessageInfo{"Stamp", true, "poise.clock:Stamp"}), at, computer)

// How long something took: surely within `error` of `value` [s].
struct Elapsed {
  double value = 0.0, error = 0.0;
};
POISE_FIELDS(Elapsed, (MessageInfo{"Elapsed", true, "poise.clock:Elapsed"}), value, error)

// Bytes, where `std::string` is text.
struct Bytes {
  std::string data;
};

// A NumPy array of one piece: what came is read-only, and lies where it came.
template <typename T>
class Array {
 public:
  using Shape = std::vector<std::size_t>;

  Array() : Array(Shape{0}) {}

  // A new one, of zeros.
  explicit Array(Shape shape) : shape_(std::move(shape)) {
    auto own = std::make_shared<std::unique_ptr<T[]>>(new T[std::max<std::size_t>(1, size())]());
    data_ = std::shared_ptr<const T>(own, own->get());
    writable_ = own->get();
  }

  // A new one of any content in shared memory, as `poise.loan`.
  static Array loan(const Shape& shape) {
    const Locked lock;
    nb::list sides;
    for (const std::size_t side : shape) sides.append(side);
    const nb::object array = detail::from_python("poise", "loan")(nb::tuple(sides), name());
    auto loaned = nb::cast<nb::ndarray<T, nb::c_contig, nb::device::cpu>>(array);
    Array made(array, nb::ndarray<const T, nb::c_contig, nb::device::cpu>(loaned));
    made.writable_ = loaned.data();
    return made;
  }

  const Shape& shape() const { return shape_; }
  std::size_t size() const {
    return std::accumulate(shape_.begin(), shape_.end(), std::size_t{1}, std::multiplies<>());
  }
  const T* data() const { return data_.get(); }
  const T& operator[](std::size_t index) const { return data_.get()[index]; }
  const T* begin() const { return data(); }
  const T* end() const { return data() + size(); }

  // To fill an array that was made here, before it is handed over.
  T* writable() {
    if (!writable_) throw std::logic_error("an array that came is read-only: fill a new one");
    return writable_;
  }

  // What Python knows of it.
  using View = nb::ndarray<const T, nb::c_contig, nb::device::cpu>;
  Array(nb::handle array, View view) {
    for (std::size_t i = 0; i < view.ndim(); ++i) shape_.push_back(view.shape(i));
    const T* data = view.data();
    source_ = std::make_shared<Source>(nb::borrow(array), std::move(view));
    data_ = std::shared_ptr<const T>(source_, data);
  }
  nb::object python() const {
    if (source_) return source_->array;
    const nb::capsule owner(new std::shared_ptr<const T>(data_), [](void* data) noexcept {
      delete static_cast<std::shared_ptr<const T>*>(data);
    });
    return nb::cast(nb::ndarray<nb::numpy, const T>(data(), shape_.size(), shape_.data(), owner));
  }
  static std::string name() {
    if constexpr (std::is_same_v<T, bool>) return "bool";
    const char* kind = std::is_floating_point_v<T> ? "float" : std::is_signed_v<T> ? "int" : "uint";
    return kind + std::to_string(8 * sizeof(T));
  }

 private:
  struct Source {
    Source(nb::object object, View shown) : array(std::move(object)), view(std::move(shown)) {}
    ~Source() {
      const Locked lock;
      array.reset();
      view = View();
    }
    nb::object array;
    View view;
  };

  Shape shape_;
  std::shared_ptr<Source> source_;  // none: the array was made here
  std::shared_ptr<const T> data_;
  T* writable_ = nullptr;
};

namespace detail {

// The type in Python of one in C++, and what tells apart types of one name with other fields.
template <typename T>
struct TypeOf;

template <Message T>
const nb::object& message_class();

// The names of a message's fields, as Python looks them up.
template <Message T>
PyObject* const* field_names() {
  static const auto* names = [] {
    auto* all = new std::vector<PyObject*>();
    T message{};
    poise_visit(message, [&](const char* name, auto&) {
      all->push_back(PyUnicode_InternFromString(name));
    });
    return all;
  }();
  return names->data();
}

// The messages and interfaces that were made, which the module is to have as attributes.
inline nb::dict& made_classes() {
  static auto* all = new nb::dict();
  return *all;
}

// Make a class by a function of Poise's, with a name in this module.
template <typename... Args>
nb::object made_class(const char* function, const char* name, const Args&... args) {
  nb::object made = from_python("poise.runtime.hosting.cpp_component", function)(
      name, POISE_MODULE_NAME, args...);
  made_classes()[name] = made;
  return made;
}

template <typename T>
nb::object python_type() {
  return TypeOf<std::remove_cvref_t<T>>::python();
}
template <typename T>
std::string layout() {
  return TypeOf<std::remove_cvref_t<T>>::layout();
}

inline nb::object builtin(const char* name) { return from_python("builtins", name); }

template <typename T>
struct TypeOf {
  static nb::object python() {
    if constexpr (Message<T>) {
      return message_class<T>();
    } else if constexpr (std::is_same_v<T, bool>) {
      return builtin("bool");
    } else if constexpr (std::is_integral_v<T>) {
      using Limits = std::numeric_limits<T>;
      return from_python("poise.runtime.hosting.cpp_component", "integer_type")(Limits::min(),
                                                                                Limits::max());
    } else if constexpr (std::is_floating_point_v<T>) {
      return builtin("float");
    } else if constexpr (std::is_same_v<T, std::string>) {
      return builtin("str");
    } else if constexpr (std::is_same_v<T, Bytes>) {
      return builtin("bytes");
    } else if constexpr (std::is_void_v<T>) {
      return nb::none();
    } else {
      static_assert(Message<T>,
                    "not a type that messages may have: list the fields of a struct by "
                    "POISE_MESSAGE, in its namespace and before it is used");
    }
  }
  static std::string layout() {
    std::string text = typeid(T).name();
    if constexpr (Message<T>) {
      T message{};
      poise_visit(message, [&](const char* name, auto& field) {
        text += std::string(",") + name + ":" + detail::layout<decltype(field)>();
      });
      text += ";";
    }
    return text;
  }
};

template <typename T>
nb::object generic(const char* of, const T& arguments) {
  return builtin(of).attr("__class_getitem__")(arguments);
}

template <typename T>
struct TypeOf<std::vector<T>> {
  static nb::object python() { return generic("list", python_type<T>()); }
  static std::string layout() { return "[" + detail::layout<T>() + "]"; }
};
template <typename T>
struct TypeOf<std::map<std::string, T>> {
  static nb::object python() {
    return generic("dict", nb::make_tuple(builtin("str"), python_type<T>()));
  }
  static std::string layout() { return "{" + detail::layout<T>() + "}"; }
};
template <typename T>
struct TypeOf<std::optional<T>> {
  static nb::object python() { return python_type<T>() | nb::none(); }
  static std::string layout() { return "?" + detail::layout<T>(); }
};
template <typename T, std::size_t Size>
struct TypeOf<std::array<T, Size>> {
  static nb::object python() {
    nb::list parts;
    for (std::size_t i = 0; i < Size; ++i) parts.append(python_type<T>());
    return generic("tuple", nb::tuple(parts));
  }
  static std::string layout() { return std::to_string(Size) + "*" + detail::layout<T>(); }
};
template <typename T>
struct TypeOf<Array<T>> {
  static nb::object python() {
    return from_python("poise.runtime.hosting.cpp_component", "array_type")(Array<T>::name());
  }
  static std::string layout() { return "array " + Array<T>::name(); }
};

template <Message T>
const nb::object& message_class() {
  static const auto* made = [] {
    const MessageInfo info = poise_info(static_cast<const T*>(nullptr));
    if (info.python_class) {
      const std::string place = info.python_class;
      const std::size_t colon = place.find(':');
      return new nb::object(
          from_python(place.substr(0, colon).c_str(), place.substr(colon + 1).c_str()));
    }
    nb::dict fields, defaults;
    const T initial{};
    poise_visit(initial, [&](const char* name, const auto& field) {
      fields[name] = python_type<decltype(field)>();
      if (info.has_defaults) defaults[name] = nb::cast(field);
    });
    return new nb::object(made_class("message", info.name, fields, defaults));
  }();
  return *made;
}

}  // namespace detail
}  // namespace poise

namespace nanobind::detail {

template <typename T>
struct type_caster<T, enable_if_t<poise::Message<T>>> {
  NB_TYPE_CASTER(T, const_name("message"))

  bool from_python(handle source, std::uint8_t flags, cleanup_list* cleanup) noexcept {
    bool fits = true;
    PyObject* const* names = poise::detail::field_names<T>();
    poise_visit(value, [&](const char*, auto& field) {
      if (!fits) return;
      PyObject* attribute = PyObject_GetAttr(source.ptr(), *names++);
      if (!attribute) {
        PyErr_Clear();
        fits = false;
        return;
      }
      using Field = std::remove_cvref_t<decltype(field)>;
      make_caster<Field> caster;
      fits = caster.from_python(attribute, flags_for_local_caster<Field>(flags), cleanup);
      if (fits) field = caster.operator cast_t<Field>();
      Py_DECREF(attribute);
    });
    return fits;
  }

  static handle from_cpp(const T& message, rv_policy, cleanup_list* cleanup) noexcept {
    constexpr std::size_t most = 342;  // that for_each.hpp takes
    PyObject* fields[most];
    std::size_t count = 0;
    bool fits = true;
    poise_visit(message, [&](const char*, const auto& field) {
      if (!fits) return;
      using Field = std::remove_cvref_t<decltype(field)>;
      fields[count] = make_caster<Field>::from_cpp(field, rv_policy::copy, cleanup).ptr();
      fits = fields[count] != nullptr;
      count += fits;
    });
    PyObject* made = nullptr;
    if (fits) {
      const auto& type = poise::detail::message_class<T>();
      made = PyObject_Vectorcall(type.ptr(), fields, count, nullptr);
    }
    while (count > 0) Py_DECREF(fields[--count]);
    return made;
  }
};

template <typename T>
struct type_caster<poise::Array<T>> {
  NB_TYPE_CASTER(poise::Array<T>, const_name("numpy.ndarray"))

  bool from_python(handle source, std::uint8_t flags, cleanup_list* cleanup) noexcept {
    make_caster<typename poise::Array<T>::View> caster;
    if (!caster.from_python(source, flags, cleanup)) return false;
    value = poise::Array<T>(source, std::move(caster.value));
    return true;
  }
  static handle from_cpp(const poise::Array<T>& array, rv_policy, cleanup_list*) noexcept {
    return array.python().release();
  }
};

template <typename T, std::size_t Size>
struct type_caster<std::array<T, Size>> : array_caster<std::array<T, Size>, T, Size> {
  using List = array_caster<std::array<T, Size>, T, Size>;

  static handle from_cpp(const std::array<T, Size>& parts, rv_policy policy,
                         cleanup_list* cleanup) noexcept {
    const object list = steal(List::from_cpp(parts, policy, cleanup));
    return list.is_valid() ? PyList_AsTuple(list.ptr()) : nullptr;
  }
};

template <>
struct type_caster<poise::Bytes> {
  NB_TYPE_CASTER(poise::Bytes, const_name("bytes"))

  bool from_python(handle source, std::uint8_t, cleanup_list*) noexcept {
    char* data = nullptr;
    Py_ssize_t size = 0;
    if (PyBytes_AsStringAndSize(source.ptr(), &data, &size) != 0) {
      PyErr_Clear();
      return false;
    }
    value.data.assign(data, static_cast<std::size_t>(size));
    return true;
  }
  static handle from_cpp(const poise::Bytes& bytes, rv_policy, cleanup_list*) noexcept {
    return PyBytes_FromStringAndSize(bytes.data.data(), static_cast<Py_ssize_t>(bytes.data.size()));
  }
};

}  // namespace nanobind::detail
