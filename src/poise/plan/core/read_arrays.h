// Makes a problem of `Arrays` in ../problem/arrays.py.
#pragma once

#include <nanobind/nanobind.h>
#include <nanobind/stl/map.h>
#include <nanobind/stl/pair.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include <stdexcept>

#include "problem.h"

namespace poise {

namespace nb = nanobind;

// Reads fields of `poise.plan.problem.arrays.Arrays`, and refuses what would make the solvers
// read where nothing is. Whether numbers make sense has been looked at by
// `poise.plan.problem.problem`.
struct Fields {
  nb::handle arrays;

  template <typename T>
  T get(const char* name) const {
    return nb::cast<T>(arrays.attr(name));
  }

  int size(const char* name, std::int64_t most) const {
    const auto value = get<std::int64_t>(name);
    if (value >= 0 && value <= most) return static_cast<int>(value);
    throw std::invalid_argument(std::string(name) + " is " + std::to_string(value));
  }

  std::vector<double> numbers(const char* name, std::size_t length) const {
    auto values = get<std::vector<double>>(name);
    if (values.size() == length) return values;
    throw std::invalid_argument(std::string(name) + " has " + std::to_string(values.size()) +
                                " entries, must have " + std::to_string(length));
  }

  // Numbers that may be left out.
  std::vector<double> table(const char* name, std::size_t length) const {
    const nb::object values = arrays.attr(name);
    return nb::len(values) == 0 ? std::vector<double>{} : numbers(name, length);
  }

  static void check_index(const char* name, std::int64_t value, std::int64_t end) {
    if (value >= 0 && value < end) return;
    throw std::invalid_argument(std::string(name) + " has the index " +
                                std::to_string(value) + ", must be in [0, " +
                                std::to_string(end) + ")");
  }
};

using Pairs = std::vector<std::pair<std::int32_t, std::int32_t>>;
using Connectors = std::vector<std::tuple<std::int32_t, std::int32_t, double, double>>;
using Allowed = std::map<std::int32_t, std::vector<std::int32_t>>;
using Runs = std::vector<std::pair<std::int32_t, double>>;
using Hops = std::vector<std::tuple<std::int32_t, std::int32_t, double, double, double>>;
using Limits = std::vector<std::tuple<double, double, double, std::int32_t, Runs, Hops>>;

constexpr int kMostPower = 1024;  // more than any computer's

// Read `poise.plan.problem.arrays.Times`.
inline TimeLimits read_times(const Fields& in, const Problem& p,
                             const std::vector<std::int32_t>& unit_of) {
  const std::size_t m = p.m;
  TimeLimits out;
  out.speed = in.numbers("speed", m);
  out.latency = in.table("latency", m * m);
  out.per_byte = in.table("per_byte", m * m);
  const auto cores = in.get<std::vector<int>>("cores");
  const auto powers = in.get<std::vector<int>>("power");
  if (cores.size() != m || powers.size() != m) {
    throw std::invalid_argument("cores and power must have " + std::to_string(m) + " entries");
  }
  for (const int power : powers) Fields::check_index("power", power, kMostPower);
  out.set_queues(cores, powers);
  for (const auto& [limit, price, fixed, cpu, runs, hops] : in.get<Limits>("limits")) {
    if (cpu != -1) Fields::check_index("cpu", cpu, p.r);
    TimeLimits::Limit each{limit, price, fixed, cpu, {}, {}};
    const auto components = static_cast<std::int64_t>(unit_of.size());
    for (const auto& [component, seconds] : runs) {
      Fields::check_index("runs", component, components);
      each.runs.push_back({unit_of[component], component, seconds});
    }
    for (const auto& [a, b, seconds, crossings, size] : hops) {
      for (const std::int32_t component : {a, b}) {
        Fields::check_index("hops", component, components);
      }
      if (unit_of[a] == unit_of[b]) continue;
      each.hops.push_back({unit_of[a], unit_of[b], seconds, crossings, size});
    }
    out.limits.push_back(std::move(each));
  }
  return out;
}

inline Problem read(const Fields& in, const std::vector<std::int32_t>& unit_of) {
  Problem p;
  p.n = in.size("n", 1 << 28);
  p.m = in.size("m", 1 << 20);
  p.r = in.size("r", 1024);
  const std::size_t n = p.n, m = p.m, r = p.r;
  if (n > 0 && m == 0) throw std::invalid_argument("there are no computers");
  p.weight = in.numbers("spread", r);
  p.size_weight = in.numbers("size_weight", r);
  p.distance = in.table("distance", m * m);
  p.cost = in.table("cost", n * m);
  p.bandwidth = in.table("bandwidth", m * m);
  p.price = in.numbers("price", r);
  p.variance = in.get<bool>("variance");
  p.set_rooms(in.numbers("capacity", m * r), in.numbers("limit", m * r), in.get<bool>("share"));
  const auto connectors = in.get<Connectors>("connectors");
  const auto communication = in.get<double>("communication");
  for (const auto& [a, b, overhead, traffic] : connectors) {
    for (const std::int32_t unit : {a, b}) Fields::check_index("connectors", unit, p.n);
  }
  p.connect([&](auto add) {
    for (const auto& [a, b, overhead, traffic] : connectors) {
      if (a == b) continue;
      add(a, {b, communication * overhead, traffic});
      add(b, {a, communication * overhead, traffic});
    }
  });
  const auto apart = in.get<Pairs>("apart");
  for (const auto& [a, b] : apart) {
    for (const std::int32_t unit : {a, b}) Fields::check_index("apart", unit, p.n);
  }
  p.keep_apart([&](auto add) {
    for (const auto& [a, b] : apart) {
      add(a, b);
      add(b, a);
    }
  });
  const auto allowed = in.get<Allowed>("allowed");
  for (const auto& [unit, computers] : allowed) {
    Fields::check_index("allowed", unit, p.n);
    for (const std::int32_t h : computers) Fields::check_index("allowed", h, p.m);
  }
  p.restrict_units(allowed);
  for (const std::int32_t unit : unit_of) Fields::check_index("unit_of", unit, p.n);
  const nb::object times = in.arrays.attr("times");
  if (times.is_none()) return p;
  p.limit_time(read_times(Fields{times}, p, unit_of));
  return p;
}

}  // namespace poise
