// A vehicle's gateway to mapshift in C++17: call `on_odometry` and `on_scan` from your callbacks.
//
// docs/how-to/write-a-gateway.md has the rules. As it stands, messages come from standard input, one JSON object a line:
// replace `main`. A vehicle has one lidar here; the example in Python takes several.

#include <nlohmann/json.hpp>

#include <ctime>
#include <tuple>

#include "spool.hpp"
#include "uploader.hpp"

using json = nlohmann::ordered_json;

struct Settings {
    std::string url, route, vehicle;  // the key is in the environment, MAPSHIFT_KEY; a vehicle has at most 32 characters
    fs::path spool;
    int scans_per_batch = 60;
    double timeout_s = 60, first_wait_s = 1;  // doubled by each failure, up to 300 s
    double seconds_per_batch = 10;
    std::uintmax_t spool_bytes_max = 2ull << 30;
};

struct Odometry {  // the pose of the base in the odometry frame
    std::int64_t stamp_ns = 0;
    double x = 0, y = 0, theta = 0;

    bool continues(const Odometry &before) const {  // both can be of one odometry frame
        const double elapsed_s = (stamp_ns - before.stamp_ns) * 1e-9;
        const double moved_m = std::hypot(x - before.x, y - before.y);
        const double turned_rad = std::abs(std::remainder(theta - before.theta, 2 * M_PI));
        return elapsed_s >= 0 && elapsed_s <= 30 && moved_m < 0.5 + 5 * elapsed_s && turned_rad < 0.5 + 4 * elapsed_s;
    }
};

struct Scan {
    std::int64_t stamp_ns;
    json lidar;   // the fields of `lidar` in an upload
    json ranges;  // metres; null is no return
};

std::string in_utc(std::int64_t stamp_ns, const char *format) {
    const std::time_t seconds = stamp_ns / 1'000'000'000;
    std::tm parts{};
    char text[32];
    std::strftime(text, sizeof text, format, gmtime_r(&seconds, &parts));
    return text;
}

std::string digits(std::int64_t number, int width) {
    char text[24];
    std::snprintf(text, sizeof text, "%0*lld", width, static_cast<long long>(number));
    return text;
}

/// Whether the clock was set back, or a simulation or a recording begins again. By less than a second, a message came
/// late or twice.
bool is_step_back(std::int64_t newest_ns, std::int64_t stamp_ns) { return stamp_ns < newest_ns - 1'000'000'000; }

/// Whether JSON can state it: it has neither NaN nor infinity.
bool is_finite(const json &value) {
    if (value.is_structured()) return std::all_of(value.begin(), value.end(), is_finite);
    return !value.is_number_float() || std::isfinite(value.get<double>());
}

class Gateway {
  public:
    explicit Gateway(const Settings &settings)
        : settings_(settings), spool_(settings.spool, settings.spool_bytes_max) {
        resume();
        const std::string url = settings.url + "/v1/routes/" + settings.route + "/batches";
        uploader_.emplace(url, settings.spool, settings.timeout_s, settings.first_wait_s);
    }

    void on_odometry(const Odometry &odometry) {
        std::lock_guard lock(mutex_);
        if (!is_finite({odometry.x, odometry.y, odometry.theta})) return leave_out("odometry", odometry.stamp_ns);
        if (!odometry_.empty() && is_step_back(odometry_.back().stamp_ns, odometry.stamp_ns))
            begin_anew(odometry.stamp_ns);
        if (odometry_.empty() || odometry.stamp_ns > odometry_.back().stamp_ns) odometry_.push_back(odometry);
        if (odometry_.size() > 500) odometry_.pop_front();
        take_waiting(odometry_.back().stamp_ns);
        if (Clock::now() - begun_ > Seconds(settings_.seconds_per_batch)) spool_.end();
    }

    void on_scan(const Scan &scan) {
        std::lock_guard lock(mutex_);
        if (!is_finite(scan.lidar) || !is_finite(scan.ranges)) return leave_out("scan", scan.stamp_ns);
        if (is_step_back(given_ns_, scan.stamp_ns)) begin_anew(scan.stamp_ns);
        given_ns_ = std::max(given_ns_, scan.stamp_ns);
        waiting_.push_back(scan);
        take_waiting(std::max(scan.stamp_ns - WAIT_NS, odometry_.empty() ? 0 : odometry_.back().stamp_ns));
    }

    /// Hands on what has been collected, as at the end of a drive.
    void complete_batch() {
        std::lock_guard lock(mutex_);
        take_waiting(INT64_MAX);
        spool_.end();
    }

  private:
    using Clock = std::chrono::steady_clock;
    using Seconds = std::chrono::duration<double>;
    static constexpr std::int64_t WAIT_NS = 300'000'000;  // so long a scan waits for odometry after it …
    static constexpr std::int64_t AGE_MAX_NS = 200'000'000;  // … and then takes what is no older than this
    static constexpr Seconds PAUSE{10};

    /// Goes on with the newest trip, unless a batch is damaged: an older one does not say which sequences were given
    /// since.
    void resume() try {
        for (const auto &batch : spool_.last()) resume_after(batch);
    } catch (const std::exception &error) {  // by a power cut
        std::cerr << "the last batch cannot be read, another trip begins: " << error.what() << "\n";
        trip_.clear();
        last_ = {};
    }

    /// Goes on with the trip of a batch, if it is the newest so far.
    void resume_after(const fs::path &batch) {
        std::istringstream lines(read_file(batch));
        std::string first, line, last;
        std::getline(lines, first);
        while (std::getline(lines, line) && !lines.eof()) last = line;  // as in `body_of`
        const json head = json::parse(first), scan = json::parse(last), &pose = scan.at("odometry");
        const std::string trip = head.at("trip_id"), stamp = scan.at("stamp");
        const int next = head.at("sequence").get<int>() + 1;
        if (std::tie(trip, next) < std::tie(trip_, sequence_)) return;
        std::tm parts{};
        strptime(stamp.c_str(), "%Y-%m-%dT%H:%M:%S", &parts);
        const std::int64_t stamp_ns = timegm(&parts) * 1'000'000'000 + std::stoll(stamp.substr(20, 9));
        last_ = {stamp_ns, pose.at("x"), pose.at("y"), pose.at("theta")};
        trip_ = trip;
        sequence_ = next;
    }

    /// Time went back: what waits is of the time before, and what comes is not compared with that.
    void begin_anew(std::int64_t stamp_ns) {
        take_waiting(INT64_MAX);
        end_trip("time went back: a new trip begins");
        if (!odometry_.empty() && is_step_back(odometry_.back().stamp_ns, stamp_ns)) odometry_.clear();
        given_ns_ = 0;
        last_ = {};
    }

    static void leave_out(const std::string &what, std::int64_t stamp_ns) {
        std::cerr << "the " << what << " of " << digits(stamp_ns, 0) << " ns is left out: it is not finite\n";
    }

    void take_waiting(std::int64_t ready_ns) {
        while (!waiting_.empty() && waiting_.front().stamp_ns <= ready_ns) {
            const Scan scan = waiting_.front();
            waiting_.pop_front();
            const auto odometry = odometry_at(scan.stamp_ns);
            const bool late = scan.stamp_ns <= last_.stamp_ns && last_.stamp_ns < scan.stamp_ns + 1'000'000'000;
            if (odometry && !late) {
                collect(scan, *odometry);
            } else {
                std::cerr << "the scan of " << digits(scan.stamp_ns, 0) << " ns is left out: "
                          << (late ? "it came too late, or twice\n" : "there is no odometry\n");
            }
        }
    }

    /// Interpolated, else what came shortly before.
    std::optional<Odometry> odometry_at(std::int64_t stamp_ns) const {
        const auto is_later = [](std::int64_t stamp, const Odometry &pose) { return stamp < pose.stamp_ns; };
        const auto after = std::upper_bound(odometry_.begin(), odometry_.end(), stamp_ns, is_later);
        if (after == odometry_.begin()) return std::nullopt;
        Odometry pose = *std::prev(after);
        if (after != odometry_.end() && after->continues(pose)) {
            const double part = double(stamp_ns - pose.stamp_ns) / double(after->stamp_ns - pose.stamp_ns);
            const double turned = std::remainder(after->theta - pose.theta, 2 * M_PI);
            return Odometry{stamp_ns, pose.x + part * (after->x - pose.x), pose.y + part * (after->y - pose.y),
                            pose.theta + part * turned};
        }
        if (stamp_ns - pose.stamp_ns > AGE_MAX_NS) return std::nullopt;
        pose.stamp_ns = stamp_ns;
        return pose;
    }

    void collect(const Scan &scan, const Odometry &odometry) {
        if (!trip_.empty() && !odometry.continues(last_)) end_trip("the odometry frame is another: a new trip begins");
        if (scan.lidar != lidar_ || scan.ranges.size() != beams_) spool_.end();  // all scans of a batch are alike
        lidar_ = scan.lidar;
        beams_ = scan.ranges.size();
        if (!spool_.is_open() && !begin_batch()) return;
        const std::string fraction = digits(scan.stamp_ns % 1'000'000'000, 9);
        const json line = {{"stamp", in_utc(scan.stamp_ns, "%Y-%m-%dT%H:%M:%S.") + fraction + "Z"},
                           {"odometry", {{"x", odometry.x}, {"y", odometry.y}, {"theta", odometry.theta}}},
                           {"ranges", scan.ranges}};
        if (!spool_.write(line.dump())) return pause("the spool cannot be written");
        last_ = odometry;
        if (++scans_ >= settings_.scans_per_batch) spool_.end();
    }

    bool begin_batch() {
        if (Clock::now() < paused_until_) return false;
        if (trip_.empty()) {
            const std::int64_t now_ns = std::int64_t{std::time(nullptr)} * 1'000'000'000;
            trip_ = settings_.vehicle + in_utc(now_ns, "-%Y%m%dT%H%M%S-") + digits(std::random_device{}() % 10'000, 4);
            sequence_ = 0;
        }
        const json head = {
            {"vehicle_id", settings_.vehicle}, {"trip_id", trip_}, {"sequence", sequence_}, {"lidar", lidar_}};
        if (!spool_.begin(trip_ + "-" + digits(sequence_, 6), head.dump())) {
            pause("the spool is full, has a batch of that name, or cannot be written");
            return false;
        }
        ++sequence_;
        scans_ = 0;
        begun_ = Clock::now();
        return true;
    }

    /// Ends the trip, so that what is kept of it has no gap; another begins when scans can be kept again.
    void pause(const std::string &why) {
        end_trip(why + ": scans of the next 10 s are left out");
        paused_until_ = Clock::now() + std::chrono::duration_cast<Clock::duration>(PAUSE);
    }

    void end_trip(const std::string &why) {
        std::cerr << why << "\n";
        spool_.end();
        trip_.clear();
    }

    const Settings settings_;
    std::mutex mutex_;
    std::deque<Odometry> odometry_;
    std::deque<Scan> waiting_;
    std::int64_t given_ns_ = 0;  // of the newest scan
    std::string trip_;
    int sequence_ = 0, scans_ = 0;
    Odometry last_;
    json lidar_;
    std::size_t beams_ = 0;
    Clock::time_point begun_, paused_until_;
    Spool spool_;
    std::optional<Uploader> uploader_;
};

int main(int argc, char **argv) {
    if (argc != 8) {
        std::cerr << "usage: mapshift_gateway URL ROUTE VEHICLE SPOOL SCANS_PER_BATCH TIMEOUT_S FIRST_WAIT_S\n";
        return 2;
    }
    curl_global_init(CURL_GLOBAL_DEFAULT);
    Settings settings{argv[1], argv[2], argv[3], argv[4], std::stoi(argv[5]), std::stod(argv[6]), std::stod(argv[7])};
    Gateway gateway(settings);
    for (std::string line; std::getline(std::cin, line);) {
        const json message = json::parse(line);
        if (message.contains("ranges"))
            gateway.on_scan({message["stamp_ns"], message["lidar"], message["ranges"]});
        else
            gateway.on_odometry({message["stamp_ns"], message["x"], message["y"], message["theta"]});
    }
    gateway.complete_batch();
    while (!files(settings.spool, ".open").empty() || !files(settings.spool, ".scans").empty())
        std::this_thread::sleep_for(std::chrono::milliseconds(50));
}
