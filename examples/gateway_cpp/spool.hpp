// The files between a gateway's callbacks and its uploader.
//
// NAME.open is a batch that is being collected, NAME.scans one that is complete and waits for the service,
// last-stored the one that was stored last, refused/ has what the service will not take. The first line of a batch has
// the fields of the upload but its scans, each further line is a scan.
#pragma once

#include <fcntl.h>
#include <unistd.h>

#include <algorithm>
#include <condition_variable>
#include <cstdint>
#include <deque>
#include <filesystem>
#include <fstream>
#include <iostream>
#include <mutex>
#include <sstream>
#include <string>
#include <thread>
#include <vector>

namespace fs = std::filesystem;

inline std::string read_file(const fs::path &path) {
    std::ifstream file(path, std::ios::binary);
    return {std::istreambuf_iterator<char>(file), {}};
}

inline void sync(const fs::path &path) {
    const int descriptor = open(path.c_str(), O_RDONLY);
    if (descriptor < 0 || fsync(descriptor) != 0) std::cerr << path << " cannot be synced\n";
    if (descriptor >= 0) close(descriptor);
}

/// Of a directory, sorted by name; of any extension if it is empty.
inline std::vector<fs::path> files(const fs::path &directory, const std::string &extension) {
    std::vector<fs::path> found;
    for (const auto &entry : fs::directory_iterator(directory))
        if (extension.empty() || entry.path().extension() == extension) found.push_back(entry.path());
    std::sort(found.begin(), found.end());
    return found;
}

/// The upload of a batch: its first line has all fields but the scans, each further line is a scan.
inline std::string body_of(const fs::path &batch) {
    std::istringstream lines(read_file(batch));
    std::string body, line, separator = ",\"scans\":[";
    std::getline(lines, body);
    if (!body.empty()) body.pop_back();  // a damaged file has no head, and the service refuses it
    while (std::getline(lines, line) && !lines.eof()) {  // one without a line feed was not written to its end
        body += separator + line;
        separator = ",";
    }
    return body + "]}";
}

/// A written line survives the end of the process at once, and the end of the machine once its batch is complete.
class Spool {
  public:
    Spool(fs::path directory, std::uintmax_t bytes_max) : directory_(std::move(directory)), bytes_max_(bytes_max) {
        fs::create_directories(directory_ / "refused");
        for (const auto &left : files(directory_, ".open")) publish(left);  // of a process that was killed
        thread_ = std::thread([this] { publish_ended(); });
    }

    ~Spool() {
        end();
        {
            std::lock_guard lock(mutex_);
            stop_ = true;
        }
        changed_.notify_all();
        thread_.join();
    }

    /// Where the newest batch is, by which a trip goes on after a restart: one of at most two.
    std::vector<fs::path> last() const {
        auto kept = files(directory_, ".scans");
        for (const auto &refused : files(directory_ / "refused", ".scans")) kept.push_back(refused);
        const auto by_name = [](const fs::path &a, const fs::path &b) { return a.filename() < b.filename(); };
        std::vector<fs::path> found;
        if (!kept.empty()) found.push_back(*std::max_element(kept.begin(), kept.end(), by_name));
        if (fs::exists(directory_ / "last-stored")) found.push_back(directory_ / "last-stored");
        return found;
    }

    bool is_open() const { return file_.is_open(); }

    /// Begins a batch, unless there is no room for it or its name is taken.
    bool begin(const std::string &name, const std::string &head) {
        if (has(name) || !make_room()) return false;
        path_ = directory_ / (name + ".open");
        file_.open(path_, std::ios::binary | std::ios::trunc);
        return write(head);
    }

    /// Hands a line to the kernel, not to the disk: that would take too long here.
    bool write(const std::string &line) { return static_cast<bool>(file_ << line << '\n' << std::flush); }

    /// Completes the batch, if there is one.
    void end() {
        if (!file_.is_open()) return;
        file_.close();
        file_.clear();
        {
            std::lock_guard lock(mutex_);
            ended_.push_back(path_);
        }
        changed_.notify_all();
    }

  private:
    /// Whether a batch of this name is being collected, waits or was refused: another would take its place.
    bool has(const std::string &name) const {
        const fs::path complete = name + ".scans";
        return fs::exists(directory_ / (name + ".open")) || fs::exists(directory_ / complete) ||
               fs::exists(directory_ / "refused" / complete);
    }

    void publish_ended() {
        std::unique_lock lock(mutex_);
        while (true) {
            changed_.wait(lock, [this] { return stop_ || !ended_.empty(); });
            if (ended_.empty()) return;
            const fs::path batch = ended_.front();
            ended_.pop_front();
            lock.unlock();
            publish(batch);
            lock.lock();
        }
    }

    void publish(const fs::path &batch) {
        const std::string text = read_file(batch);
        std::error_code error;
        if (std::count(text.begin(), text.end(), '\n') < 2) {
            fs::remove(batch, error);  // no scan
        } else {
            sync(batch);
            fs::rename(batch, fs::path(batch).replace_extension(".scans"), error);
            sync(directory_);
        }
        if (error) std::cerr << batch << " cannot be completed: " << error.message() << "\n";  // the next start tries again
    }

    /// Forgets the oldest refused batches if the spool is full.
    bool make_room() {
        auto refused = files(directory_ / "refused", "");
        std::sort(refused.begin(), refused.end(), [](const auto &a, const auto &b) { return written(a) < written(b); });
        std::uintmax_t size = 0;
        for (const auto &file : files(directory_, "")) size += size_of(file);  // 0 for refused/
        for (const auto &file : refused) size += size_of(file);
        for (const auto &file : refused) {
            if (size <= bytes_max_) break;
            size -= size_of(file);
            std::error_code error;
            fs::remove(file, error);
        }
        return size <= bytes_max_;
    }

    static std::uintmax_t size_of(const fs::path &file) {
        std::error_code error;  // the uploader may just have moved it
        const auto size = fs::file_size(file, error);
        return error ? 0 : size;
    }

    static fs::file_time_type written(const fs::path &file) {
        std::error_code error;
        return fs::last_write_time(file, error);
    }

    const fs::path directory_;
    const std::uintmax_t bytes_max_;
    fs::path path_;
    std::ofstream file_;
    std::mutex mutex_;
    std::condition_variable changed_;
    std::deque<fs::path> ended_;
    bool stop_ = false;
    std::thread thread_;
};
