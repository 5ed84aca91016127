// Steps of a task on a lattice, simulated and judged in advance: one for each state and action.
#include <nanobind/nanobind.h>
#include <nanobind/stl/array.h>
#include <nanobind/stl/vector.h>

#include <algorithm>
#include <array>
#include <cstring>
#include <stdexcept>
#include <vector>

#include "arrays.h"
#include "bindings.h"

namespace nb = nanobind;

namespace splatrl {

namespace {

constexpr int64_t GOAL = 1, TIMEOUT = 4;  // as in Outcome
constexpr size_t POSE = 16;               // floats in a pose

struct Step {
    int64_t state, outcome;  // state: the index of the resulting state
    float free_fraction, reward;
    bool terminated;
};

// The curriculum's level and cohort, with the same rules as Schedule in Python.
struct Cohort {
    int64_t* progress;  // the level, and how many of the cohort's episodes have ended and succeeded
    bool* members;      // [rows]
    size_t rows;
    int64_t levels, window, enough;

    // Count the end of the episode in a row.
    void end(size_t row, bool success) {
        if (!members[row]) return;
        members[row] = false;
        progress[1] += 1;
        progress[2] += success;
    }

    // Promote, or begin another cohort, if this one's episodes have settled it.
    void decide() {
        const bool promoted = progress[2] >= enough;
        if (!promoted && progress[1] - progress[2] <= window - enough) return;
        progress[0] = std::min(progress[0] + promoted, levels - 1);
        progress[1] = progress[2] = 0;
        std::fill_n(members, rows, false);
    }

    // Take the episodes that have begun in some rows, given in ascending order, into the cohort until it is complete.
    void begin(const int64_t* begun, size_t some) {
        for (size_t i = 0; i < some; ++i) end(size_t(begun[i]), false);  // a member that still ran was cut off
        decide();
        int64_t room = window - progress[1] - std::count(members, members + rows, true);
        for (size_t i = 0; i < some && room > 0; ++i, --room) members[begun[i]] = true;
    }
};

class StepTable {
public:
    // Addresses of progress and members, and the number of rows, levels and episodes in a cohort, and how many
    // successes are enough.
    using Curriculum = std::array<uintptr_t, 6>;

    StepTable(std::vector<int64_t> shape, Tensor<const int64_t, -1, -1> next, Tensor<const float, -1, -1> free_fraction,
                 Tensor<const float, -1, -1> reward, Tensor<const bool, -1, -1> terminated,
                 Tensor<const int64_t, -1, -1> outcome, Tensor<const float, -1, 4, 4> poses)
        : shape_(std::move(shape)), actions_(next.shape(1)), poses_(poses.data(), poses.data() + poses.size()) {
        size_t states = 1;
        for (int64_t count : shape_) states *= size_t(count);
        const auto fits = [&](const auto& table) { return table.shape(0) == states && table.shape(1) == actions_; };
        if (!fits(next) || !fits(free_fraction) || !fits(reward) || !fits(terminated) || !fits(outcome) ||
            poses.shape(0) != states)
            throw std::invalid_argument("StepTable: expected a row for each state and a column for each action");
        for (size_t i = 0; i < next.size(); ++i) {
            if (next.data()[i] < 0 || size_t(next.data()[i]) >= states)
                throw std::invalid_argument("next: expected state indices in [0, number of states)");
            steps_.push_back({next.data()[i], outcome.data()[i], free_fraction.data()[i], reward.data()[i],
                              terminated.data()[i]});
        }
    }

    // Look up the step of each row. `given` holds the addresses of state, action, step_count, episode_return, level and
    // goals; `found` those of the same without action, then of outcome, free_fraction, reward, success, done,
    // terminated, truncated and the resulting poses. `rows` is the address of the rows of the batch that step, or 0 for
    // all. Returns false, and writes nothing, if a row is off the lattice.
    bool step(const std::array<uintptr_t, 6>& given, const std::array<uintptr_t, 13>& found, size_t count,
              uintptr_t rows, int64_t max_steps, int64_t goals_for_success, const Curriculum& curriculum) const {
        const auto *state = at<const int64_t>(given[0]), *action = at<const int64_t>(given[1]);
        for (size_t row = 0; row < count; ++row)
            if (!known(state + row * shape_.size(), action[row])) return false;
        Cohort cohort = cohort_of(curriculum);
        const int64_t now = cohort.progress[0];
        for (size_t row = 0; row < count; ++row) {
            const Step& taken = steps_[number(state + row * shape_.size()) * actions_ + size_t(action[row])];
            const int64_t steps = at<const int64_t>(given[2])[row] + 1, level = at<const int64_t>(given[4])[row];
            const int64_t goals = at<const int64_t>(given[5])[row] + (taken.outcome == GOAL);
            const bool truncated = steps >= max_steps && !taken.terminated, done = taken.terminated || truncated;
            const bool success = goals >= goals_for_success;
            put_state(taken.state, at<int64_t>(found[0]) + row * shape_.size());
            at<int64_t>(found[1])[row] = steps;
            at<float>(found[2])[row] = at<const float>(given[3])[row] + taken.reward;
            at<int64_t>(found[3])[row] = level;
            at<int64_t>(found[4])[row] = goals;
            at<int64_t>(found[5])[row] = truncated ? TIMEOUT : taken.outcome;
            at<float>(found[6])[row] = taken.free_fraction;
            at<float>(found[7])[row] = taken.reward;
            at<bool>(found[8])[row] = success;
            at<bool>(found[9])[row] = done;
            at<bool>(found[10])[row] = taken.terminated;
            at<bool>(found[11])[row] = truncated;
            std::memcpy(at<float>(found[12]) + row * POSE, &poses_[size_t(taken.state) * POSE], sizeof(float) * POSE);
            if (done && level == now) cohort.end(rows ? size_t(at<const int64_t>(rows)[row]) : row, success);
        }
        cohort.decide();
        return true;
    }

    // Copy a batch, and begin new episodes in some of its rows, in ascending order. `old` and `found` hold the
    // addresses of state, step_count, episode_return, level, goals, outcome, free_fraction, success, done, terminated
    // and truncated; `found` also that of the poses of the rows that begin.
    void begin(const std::array<uintptr_t, 11>& old, const std::array<uintptr_t, 12>& found, size_t count,
               uintptr_t rows, size_t some, uintptr_t uniform, uintptr_t starts, int64_t available,
               const Curriculum& curriculum) const {
        const size_t size = shape_.size() * sizeof(int64_t), number = sizeof(int64_t), share = sizeof(float);
        const size_t bytes[] = {size, number, share, number, number, number, share, 1, 1, 1, 1};  // per row
        Cohort cohort = cohort_of(curriculum);
        const int64_t level = cohort.progress[0];
        for (size_t i = 0; i < old.size(); ++i)
            std::memcpy(at<char>(found[i]), at<const char>(old[i]), count * bytes[i]);
        for (size_t i = 0; i < some; ++i) {
            const size_t row = size_t(at<const int64_t>(rows)[i]);
            if (row >= count) throw std::invalid_argument("rows: expected row indices of the batch");
            const int64_t drawn = std::min(int64_t(at<const double>(uniform)[row] * double(available)), available - 1);
            const int64_t* start = at<const int64_t>(starts) + size_t(drawn) * shape_.size();
            if (!known(start, 0)) throw std::invalid_argument("starts: expected states on the lattice");
            for (size_t entry = 0; entry < old.size(); ++entry)
                std::memset(at<char>(found[entry]) + row * bytes[entry], 0, bytes[entry]);
            std::memcpy(at<int64_t>(found[0]) + row * shape_.size(), start, size);
            at<int64_t>(found[3])[row] = level;
            at<float>(found[6])[row] = 1.0f;
            std::memcpy(at<float>(found[11]) + i * POSE, &poses_[this->number(start) * POSE], sizeof(float) * POSE);
        }
        cohort.begin(at<const int64_t>(rows), some);
    }

private:
    std::vector<int64_t> shape_;
    size_t actions_;
    std::vector<Step> steps_;  // [states, actions]
    std::vector<float> poses_;

    static Cohort cohort_of(const Curriculum& of) {
        return {at<int64_t>(of[0]), at<bool>(of[1]), size_t(of[2]), int64_t(of[3]), int64_t(of[4]), int64_t(of[5])};
    }

    bool known(const int64_t* state, int64_t action) const {
        for (size_t axis = 0; axis < shape_.size(); ++axis)
            if (state[axis] < 0 || state[axis] >= shape_[axis]) return false;
        return action >= 0 && size_t(action) < actions_;
    }

    size_t number(const int64_t* state) const {
        int64_t row = 0;
        for (size_t axis = 0; axis < shape_.size(); ++axis) row = row * shape_[axis] + state[axis];
        return size_t(row);
    }

    void put_state(int64_t row, int64_t* state) const {
        for (size_t axis = shape_.size(); axis-- > 0; row /= shape_[axis]) state[axis] = row % shape_[axis];
    }
};

}  // namespace

void bind_lattice_steps(nb::module_& m) {
    nb::class_<StepTable>(m, "StepTable")
        .def(nb::init<std::vector<int64_t>, Tensor<const int64_t, -1, -1>, Tensor<const float, -1, -1>,
                      Tensor<const float, -1, -1>, Tensor<const bool, -1, -1>, Tensor<const int64_t, -1, -1>,
                      Tensor<const float, -1, 4, 4>>(),
             nb::arg("shape"), nb::arg("next"), nb::arg("free_fraction"), nb::arg("reward"), nb::arg("terminated"),
             nb::arg("outcome"), nb::arg("poses"))
        .def("step", &StepTable::step)
        .def("begin", &StepTable::begin);
}

}  // namespace splatrl
